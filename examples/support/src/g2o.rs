//! Pose graphs in the text format of g2o: `VERTEX_SE2`, `EDGE_SE2`, `VERTEX_SE3:QUAT`, `EDGE_SE3:QUAT` and `FIX`.
//!
//! R. Kümmerle et al., *g2o: a general framework for graph optimization*, 2011. A vertex is `id x y yaw` or `id x y z qx qy qz qw`,
//! an edge `from to`, such a pose, and the upper half of its information by rows. Lines of other tags are left out.

use crate::{Error, Input, fields::Fields, input};
use agv_core::{
    geometry::{LieGroup, Se2, Se3, So3},
    nalgebra::{Quaternion, UnitQuaternion, Vector3},
};
use std::{fmt::Write as _, path::Path};

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
    /// Inverse of the covariance of that.
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

    /// The pose of these fields; none if they are not one.
    fn from_fields(fields: &[f64]) -> Option<Self>;

    /// The fields of the pose.
    fn to_fields(&self) -> Vec<f64>;
}

impl G2oPose for Se2 {
    const VERTEX: &'static str = "VERTEX_SE2";
    const EDGE: &'static str = "EDGE_SE2";
    const FIELDS: &'static [&'static str] = &["x", "y", "yaw"];

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
/// A file that cannot be read, or the first vertex or edge with a field that is missing, not finite or no pose.
pub fn read<G: G2oPose>(path: impl AsRef<Path>) -> Result<G2o<G>, Error> {
    parse(&Input::read(path)?)
}

/// Reads a graph from memory.
///
/// # Errors
/// As [`read`].
pub fn parse<G: G2oPose>(input: &Input) -> Result<G2o<G>, Error> {
    let mut graph = G2o { vertices: Vec::new(), edges: Vec::new(), fixed: Vec::new() };
    for line in input.data_lines() {
        let (number, text) = line?;
        let mut fields = Fields::blank_separated(input, number, text);
        let tag = fields.text("tag")?;
        if tag == G::VERTEX {
            graph.vertices.push((identity(&mut fields, "id")?, pose(&mut fields)?));
        } else if tag == G::EDGE {
            let (from, to) = (identity(&mut fields, "from")?, identity(&mut fields, "to")?);
            let from_from_to = pose(&mut fields)?;
            let mut entries = vec![0.0; G::DOF * G::DOF];
            for row in 0..G::DOF {
                for column in row..G::DOF {
                    let entry = fields.finite("information")?;
                    (entries[row * G::DOF + column], entries[column * G::DOF + row]) = (entry, entry);
                }
            }
            graph.edges.push(Edge { from, to, from_from_to, information: G::matrix_from_slice(&entries) });
        } else if tag == "FIX" {
            graph.fixed.push(identity(&mut fields, "id")?);
        } else {
            continue;
        }
        fields.end()?;
    }
    Ok(graph)
}

fn identity<'a, I: Iterator<Item = &'a str>>(fields: &mut Fields<'a, I>, name: &str) -> Result<u64, Error> {
    // Front ends make identities of keys and counters, so they may be large; beyond u32 they are refused.
    fields.count(name, u32::MAX as usize).map(|id| id as u64)
}

fn pose<'a, G: G2oPose, I: Iterator<Item = &'a str>>(fields: &mut Fields<'a, I>) -> Result<G, Error> {
    let values = G::FIELDS.iter().map(|name| fields.finite(name)).collect::<Result<Vec<_>, _>>()?;
    G::from_fields(&values).ok_or_else(|| fields.error("the quaternion is zero"))
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
            push(&mut text, &entries[row * G::DOF + row..(row + 1) * G::DOF]);
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
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 7 1 2 0.5\nFIX 0\nEDGE_SE2 0 7 1 2 0.4 10 1 2 20 3 30\nOTHER 1\n";
    const SPACE: &str = "VERTEX_SE3:QUAT 0 1 2 3 0 0 0 2\nEDGE_SE3:QUAT 0 1 1 0 0 0 0 0.6 0.8 \
                         1 0 0 0 0 0 2 0 0 0 0 3 0 0 0 4 0 0 5 0 6\n";

    #[test]
    fn round_trips_keep_every_number() {
        let plane: G2o<Se2> = parse(&Input::new("p", PLANE)).unwrap();
        assert_eq!((plane.vertices.len(), plane.edges.len(), &plane.fixed[..]), (2, 1, &[0][..]));
        let information = plane.edges[0].information;
        assert_eq!((information[(0, 2)], information[(2, 1)], information[(2, 2)]), (2.0, 3.0, 30.0));
        let scratch = Scratch::new("g2o");
        write(scratch.path("p.gz"), &plane).unwrap();
        let again: G2o<Se2> = read(scratch.path("p")).unwrap();
        assert_eq!(again.edges, plane.edges);
        let space: G2o<Se3> = parse(&Input::new("s", SPACE)).unwrap();
        assert_eq!(space.edges[0].information[(5, 5)], 6.0);
        write(scratch.path("s"), &space).unwrap();
        let again: G2o<Se3> = read(scratch.path("s")).unwrap();
        assert!(again.edges[0].from_from_to.minus(&space.edges[0].from_from_to).norm() < 1e-15);
        assert_eq!(again.vertices[0].1.translation(), Vector3::new(1.0, 2.0, 3.0));
    }

    #[test]
    fn faults_name_the_line() {
        for (text, reason) in [
            ("VERTEX_SE2 0 0 0", ":1: the line ends before field 5 (yaw)"),
            ("VERTEX_SE2 x 0 0 0", ":1: field 2 (id) must be a whole number"),
            ("\nEDGE_SE2 0 1 0 0 0 1 0 0 1 NaN 1", ":2: field 11 (information) must be finite"),
            ("VERTEX_SE2 0 0 0 0 9", ":1: `9` after the 5 fields"),
        ] {
            let error = parse::<Se2>(&Input::new("r", text)).unwrap_err().to_string();
            assert!(error.contains(reason), "{error}");
        }
        let error = parse::<Se3>(&Input::new("r", "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 0")).unwrap_err().to_string();
        assert!(error.contains(":1: the quaternion is zero"), "{error}");
        survives_damage(PLANE.as_bytes(), |bytes| drop(parse::<Se2>(&Input::new("r", bytes))));
        survives_damage(SPACE.as_bytes(), |bytes| drop(parse::<Se3>(&Input::new("r", bytes))));
    }

    #[test]
    fn the_graph_of_the_intel_log_is_all_there() {
        if let Some(path) = shared("slam2d/INTEL_posegraph.g2o.gz") {
            let graph: G2o<Se2> = read(path).unwrap();
            assert_eq!((graph.vertices.len(), graph.edges.len()), (1228, 1483));
        }
    }
}
