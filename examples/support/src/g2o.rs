//! Pose graphs in the text format of g2o: `VERTEX_SE2`, `EDGE_SE2`, `VERTEX_SE3:QUAT`, `EDGE_SE3:QUAT` and `FIX`.
//!
//! R. Kümmerle et al., *g2o: a general framework for graph optimization*, 2011. A vertex is `id x y yaw` or `id x y z qx qy qz qw`,
//! an edge `from to`, such a pose, and the upper half of its information by rows. Lines of other tags are left out.
//!
//! g2o states what is off in space by the vector part of the unit quaternion, half a small angle, and so is the information in its
//! files; here it is that of angles in radians, as everywhere else. Both are read and written in the frame of the second pose.

use crate::{Error, Input, fields::Fields, input};
use agv_core::{
    geometry::{LieGroup, Se2, Se3, So3},
    nalgebra::{Quaternion, UnitQuaternion, Vector3},
};
#[cfg(feature = "graph")]
use agv_filters::graph::{PoseGraph, PoseId, Relation};
use std::{collections::BTreeMap, fmt::Write as _, path::Path};

/// A pose graph as the file has it.
#[derive(Debug, Clone, PartialEq)]
pub struct G2o<G: LieGroup> {
    /// Vertices: identity and pose in the map.
    pub vertices: Vec<(u64, G)>,
    /// Relations between two vertices.
    pub edges: Vec<Edge<G>>,
    /// Vertices that are to stay where they are.
    pub fixed: Vec<u64>,
}

/// A relation between two vertices.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edge<G: LieGroup> {
    /// Identity of the vertex that was looked from.
    pub from: u64,
    /// Identity of the vertex that was looked at.
    pub to: u64,
    /// The second in the frame of the first.
    pub from_from_to: G,
    /// Inverse of the covariance of that, in the frame of the second (1/m², 1/rad²).
    pub information: G::Matrix,
}

/// Poses that g2o knows.
pub trait G2oPose: LieGroup {
    /// Tag of a vertex.
    const VERTEX: &'static str;
    /// Tag of an edge.
    const EDGE: &'static str;
    /// Names of the fields of a pose.
    const FIELDS: &'static [&'static str];
    /// What the file states of a small rotation, beside its angle.
    const ROTATION_SCALE: f64;

    /// The pose of these fields; none if they are not one.
    fn from_fields(fields: &[f64]) -> Option<Self>;

    /// The fields of the pose.
    fn to_fields(&self) -> Vec<f64>;
}

impl G2oPose for Se2 {
    const VERTEX: &'static str = "VERTEX_SE2";
    const EDGE: &'static str = "EDGE_SE2";
    const FIELDS: &'static [&'static str] = &["x", "y", "yaw"];
    const ROTATION_SCALE: f64 = 1.0;

    fn from_fields(fields: &[f64]) -> Option<Self> {
        let &[x, y, yaw] = fields else { return None };
        Some(Self::new(x, y, yaw))
    }

    fn to_fields(&self) -> Vec<f64> {
        vec![self.x(), self.y(), self.yaw()]
    }
}

impl G2oPose for Se3 {
    const VERTEX: &'static str = "VERTEX_SE3:QUAT";
    const EDGE: &'static str = "EDGE_SE3:QUAT";
    const FIELDS: &'static [&'static str] = &["x", "y", "z", "qx", "qy", "qz", "qw"];
    const ROTATION_SCALE: f64 = 0.5;

    fn from_fields(fields: &[f64]) -> Option<Self> {
        let &[x, y, z, qx, qy, qz, qw] = fields else { return None };
        let rotation = UnitQuaternion::try_new(Quaternion::new(qw, qx, qy, qz), 1e-9)?;
        Some(Self::from_parts(Vector3::new(x, y, z), So3::from(rotation)))
    }

    fn to_fields(&self) -> Vec<f64> {
        let (t, q) = (self.translation(), UnitQuaternion::from(self.rotation()));
        vec![t.x, t.y, t.z, q.i, q.j, q.k, q.w]
    }
}

/// Reads a file.
///
/// # Errors
/// A file that cannot be read; the first vertex or edge with a field that is missing, not finite or no pose, an information that
/// is none, an edge from a vertex to itself, or a vertex that is there twice or, in an edge or among those that stay, not at all.
pub fn read<G: G2oPose>(path: impl AsRef<Path>) -> Result<G2o<G>, Error> {
    parse(&Input::read(path)?)
}

/// Reads a graph from memory.
///
/// # Errors
/// As [`read`].
pub fn parse<G: G2oPose>(input: &Input) -> Result<G2o<G>, Error> {
    let mut graph = G2o { vertices: Vec::new(), edges: Vec::new(), fixed: Vec::new() };
    // Lines of the vertices by identity, and what other lines say of vertices: those may come first.
    let (mut lines, mut said) = (BTreeMap::new(), Vec::new());
    for line in input.data_lines() {
        let (number, text) = line?;
        let mut fields = Fields::blank_separated(input, number, text);
        let tag = fields.text("tag")?;
        if tag == G::VERTEX {
            let id = identity(&mut fields, "id")?;
            graph.vertices.push((id, pose(&mut fields)?));
            if let Some(earlier) = lines.insert(id, number) {
                return Err(input.line_error(number, format_args!("vertex {id} is in line {earlier} already")));
            }
        } else if tag == G::EDGE {
            let (from, to) = (identity(&mut fields, "from")?, identity(&mut fields, "to")?);
            if from == to {
                return Err(input.line_error(number, format_args!("vertex {from} is related to itself")));
            }
            let from_from_to = pose(&mut fields)?;
            let mut entries = vec![0.0; G::DOF * G::DOF];
            for row in 0..G::DOF {
                for column in row..G::DOF {
                    let entry = fields.finite("information")? * scale::<G>(row) * scale::<G>(column);
                    (entries[row * G::DOF + column], entries[column * G::DOF + row]) = (entry, entry);
                }
            }
            let information = G::matrix_from_slice(&entries);
            G::check_covariance("information", &information).map_err(|error| fields.error(error))?;
            said.extend([from, to].map(|id| (id, number)));
            graph.edges.push(Edge { from, to, from_from_to, information });
        } else if tag == "FIX" {
            for _ in 1..text.split_ascii_whitespace().count().max(2) {
                let id = identity(&mut fields, "id")?;
                said.push((id, number));
                graph.fixed.push(id);
            }
        } else {
            continue;
        }
        fields.end()?;
    }
    match said.iter().find(|(id, _)| !lines.contains_key(id)) {
        Some((id, line)) => Err(input.line_error(*line, format_args!("there is no vertex {id}"))),
        None => Ok(graph),
    }
}

/// What an entry of a tangent is in the file, beside what it is here.
fn scale<G: G2oPose>(entry: usize) -> f64 {
    if entry < G::TRANSLATION_DOF { 1.0 } else { G::ROTATION_SCALE }
}

fn identity<'a, I: Iterator<Item = &'a str>>(fields: &mut Fields<'a, I>, name: &str) -> Result<u64, Error> {
    // Front ends make identities of keys and counters, so they may be large.
    fields.count(name, usize::MAX).map(|id| id as u64)
}

fn pose<'a, G: G2oPose, I: Iterator<Item = &'a str>>(fields: &mut Fields<'a, I>) -> Result<G, Error> {
    let values = G::FIELDS.iter().map(|name| fields.finite(name)).collect::<Result<Vec<_>, _>>()?;
    G::from_fields(&values).ok_or_else(|| fields.error("the quaternion is zero"))
}

#[cfg(feature = "graph")]
impl<G: G2oPose> G2o<G> {
    /// The graph for a solver, and which of its poses each vertex is.
    ///
    /// # Errors
    /// [`agv_core::Error`] for what [`parse`] would have refused.
    pub fn into_graph(self) -> Result<(PoseGraph<G>, BTreeMap<u64, PoseId>), agv_core::Error> {
        let (mut graph, mut ids) = (PoseGraph::new(), BTreeMap::new());
        for (id, pose) in self.vertices {
            let pose = graph.add_pose(pose)?;
            if ids.insert(id, pose).is_some() {
                return Err(agv_core::Error::TooMany { name: "vertices of one identity", len: 2, max: 1 });
            }
        }
        let find = |id: u64| {
            let (least, most) = (ids.keys().next().copied(), ids.keys().next_back().copied());
            ids.get(&id).copied().ok_or(agv_core::Error::OutOfRange {
                name: "vertex of the graph",
                value: id as f64,
                min: least.map_or(0.0, |id| id as f64),
                max: most.map_or(0.0, |id| id as f64),
            })
        };
        for id in self.fixed {
            graph.hold(find(id)?)?;
        }
        for edge in self.edges {
            graph.add_relation(Relation::new(find(edge.from)?, find(edge.to)?, edge.from_from_to, edge.information))?;
        }
        Ok((graph, ids))
    }
}

/// Writes a file, gzipped if `path` ends in `.gz`.
///
/// # Errors
/// The operating system's refusal.
pub fn write<G: G2oPose>(path: impl AsRef<Path>, graph: &G2o<G>) -> Result<(), Error> {
    let mut text = String::new();
    let push = |text: &mut String, values: &[f64]| {
        for value in values {
            let _ = write!(text, " {value}");
        }
    };
    for (id, pose) in &graph.vertices {
        let _ = write!(text, "{} {id}", G::VERTEX);
        push(&mut text, &pose.to_fields());
        text.push('\n');
    }
    for id in &graph.fixed {
        let _ = writeln!(text, "FIX {id}");
    }
    for edge in &graph.edges {
        let _ = write!(text, "{} {} {}", G::EDGE, edge.from, edge.to);
        push(&mut text, &edge.from_from_to.to_fields());
        let entries = G::matrix_slice(&edge.information);
        for row in 0..G::DOF {
            let rest = (row..G::DOF).map(|c| entries[row * G::DOF + c] / (scale::<G>(row) * scale::<G>(c)));
            push(&mut text, &rest.collect::<Vec<_>>());
        }
        text.push('\n');
    }
    input::write(path, text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Scratch, shared, survives_damage};

    const PLANE: &str =
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 7 1 2 0.5\nFIX 0 7\nEDGE_SE2 0 7 1 2 0.4 10 1 2 20 3 30\nOTHER 1\n";
    /// The second vertex has an identity as front ends make them, of a letter and a counter.
    const SPACE: &str = "VERTEX_SE3:QUAT 0 1 2 3 0 0 0 2\nEDGE_SE3:QUAT 0 8646911284551352321 1 0 0 0 0 0.6 0.8 \
                         1 0 0 0 0 0 2 0 0 0 0 3 0 0 0.5 4 0 0 5 0 6\nVERTEX_SE3:QUAT 8646911284551352321 0 0 0 0 0 0 1\n";

    #[test]
    fn round_trips_keep_every_number() {
        let plane: G2o<Se2> = parse(&Input::new("p", PLANE)).unwrap();
        assert_eq!((plane.vertices.len(), plane.edges.len(), &plane.fixed[..]), (2, 1, &[0, 7][..]));
        let information = plane.edges[0].information;
        assert_eq!((information[(0, 2)], information[(2, 1)], information[(2, 2)]), (2.0, 3.0, 30.0));
        let scratch = Scratch::new("g2o");
        write(scratch.path("p.gz"), &plane).unwrap();
        let again: G2o<Se2> = read(scratch.path("p")).unwrap();
        assert_eq!(again.edges, plane.edges);
        let space: G2o<Se3> = parse(&Input::new("s", SPACE)).unwrap();
        // Of the vector part of the quaternion, which is half an angle.
        let information = space.edges[0].information;
        assert_eq!((information[(2, 2)], information[(5, 2)], information[(5, 5)]), (3.0, 0.25, 1.5));
        write(scratch.path("s"), &space).unwrap();
        let again: G2o<Se3> = read(scratch.path("s")).unwrap();
        assert!(again.edges[0].from_from_to.minus(&space.edges[0].from_from_to).norm() < 1e-15);
        assert_eq!((again.edges[0].information, again.edges[0].to), (information, 8_646_911_284_551_352_321));
        assert_eq!(again.vertices[0].1.translation(), Vector3::new(1.0, 2.0, 3.0));
    }

    #[test]
    fn faults_name_the_line() {
        for (text, reason) in [
            ("VERTEX_SE2 0 0 0", ":1: the line ends before field 5 (yaw)"),
            ("VERTEX_SE2 x 0 0 0", ":1: field 2 (id) must be a whole number"),
            ("\nEDGE_SE2 0 1 0 0 0 1 0 0 1 NaN 1", ":2: field 11 (information) must be finite"),
            ("VERTEX_SE2 0 0 0 0 9", ":1: `9` after the 5 fields"),
            ("VERTEX_SE2 3 0 0 0\n\nVERTEX_SE2 3 0 0 0", ":3: vertex 3 is in line 1 already"),
            ("EDGE_SE2 3 3 0 0 0 1 0 0 1 0 1", ":1: vertex 3 is related to itself"),
            ("VERTEX_SE2 3 0 0 0\nFIX 3 4", ":2: there is no vertex 4"),
            ("FIX", ":1: the line ends before field 2 (id)"),
            ("EDGE_SE2 0 1 0 0 0 1 0 0 1 0 1\nVERTEX_SE2 0 0 0 0", ":1: there is no vertex 1"),
            ("EDGE_SE2 0 1 0 0 0 1 0 0 -1 0 1", ":1: information is not a covariance"),
        ] {
            let error = parse::<Se2>(&Input::new("r", text)).unwrap_err().to_string();
            assert!(error.contains(reason), "{error}");
        }
        let error = parse::<Se3>(&Input::new("r", "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 0")).unwrap_err().to_string();
        assert!(error.contains(":1: the quaternion is zero"), "{error}");
        survives_damage(PLANE.as_bytes(), |bytes| drop(parse::<Se2>(&Input::new("r", bytes))));
        survives_damage(SPACE.as_bytes(), |bytes| drop(parse::<Se3>(&Input::new("r", bytes))));
    }

    #[cfg(feature = "graph")]
    #[test]
    fn graphs_have_the_poses_in_the_order_of_the_file() {
        let file: G2o<Se2> = parse(&Input::new("p", PLANE)).unwrap();
        let (graph, ids) = file.clone().into_graph().unwrap();
        assert_eq!((ids[&0].index(), ids[&7].index(), graph.relations().len()), (0, 1, 1));
        assert_eq!((graph.relations()[0].from, graph.relations()[0].to), (ids[&0], ids[&7]));
        assert_eq!(graph.poses()[1], file.vertices[1].1);
        let mut twice = file.clone();
        twice.vertices.push(twice.vertices[0]);
        let mut absent = file;
        absent.fixed.push(9);
        assert!(twice.into_graph().is_err() && absent.into_graph().is_err());
    }

    #[test]
    fn the_graph_of_the_intel_log_is_all_there() {
        if let Some(path) = shared("slam2d/INTEL_posegraph.g2o.gz") {
            let graph: G2o<Se2> = read(path).unwrap();
            assert_eq!((graph.vertices.len(), graph.edges.len()), (1228, 1483));
        }
    }
}
