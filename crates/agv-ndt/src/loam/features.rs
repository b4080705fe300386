//! Edges and surfaces of a cloud.

use super::curvature::{CurvatureParams, LinePoint, SIDE, Shape, shapes_into};
use super::surfaces::Neighbourhoods;
use crate::Error;
use crate::preprocess::LineFinder;
use agv_core::{
    check,
    compute::Par,
    sensors::{LidarReturn, PointCloud, PointSource, RangeImage, RangeImageParams, RowSource},
};
use nalgebra::Vector3;

/// Sectors of a laser line that give equally many features each (LOAM; paper 003).
const SECTORS: usize = 6;

/// Which points are features.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct FeatureParams {
    /// Edges of each sector of a laser line, at most.
    pub edges_per_sector: usize,
    /// Surface points of each sector of a laser line, at most.
    pub surfaces_per_sector: usize,
    /// How much sharper than a straight line an edge is: 3 for a corner of 90°, in units of the angle between beams.
    pub edge_bend: f64,
    /// Standard deviation of a range, in metres.
    pub range_sigma: f64,
    /// Points nearer than this are the vehicle's own, in metres.
    pub min_range: f64,
    /// Points farther than this are too few to make a surface, in metres.
    pub max_range: f64,
    /// Edge of the cubes that clouds without laser lines are thinned out by, in metres.
    pub leaf: f64,
}

impl Default for FeatureParams {
    /// The quotas are LOAM's *less sharp* edges (20) and enough surface points for a sector that sees floor and walls; 2 cm is what
    /// data sheets state; 100 m is paper 003's local map.
    fn default() -> Self {
        Self {
            edges_per_sector: 20,
            surfaces_per_sector: 20,
            edge_bend: 1.2,
            range_sigma: 0.02,
            min_range: 0.5,
            max_range: 100.0,
            leaf: 0.3,
        }
    }
}

impl FeatureParams {
    pub(super) fn validate(&self) -> Result<(), agv_core::Error> {
        check::in_range("edges_per_sector", self.edges_per_sector as f64, 0.0, 1000.0)?;
        check::in_range("surfaces_per_sector", self.surfaces_per_sector as f64, 1.0, 1000.0)?;
        check::positive("edge_bend", self.edge_bend)?;
        check::non_negative("range_sigma", self.range_sigma)?;
        check::positive("max_range", self.max_range)?;
        check::in_range("min_range", self.min_range, 0.0, self.max_range)?;
        check::in_range("leaf", self.leaf, 0.01, 10.0)?;
        Ok(())
    }
}

/// A point of an edge or surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Feature {
    /// Place in the sensor frame, in metres.
    pub position: Vector3<f32>,
    /// Seconds after the cloud's stamp.
    pub time: f32,
}

/// Edges and surface points of a cloud.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Features {
    /// Points where surfaces meet or end.
    pub edges: Vec<Feature>,
    /// Points of smooth surfaces.
    pub surfaces: Vec<Feature>,
}

impl Features {
    fn clear(&mut self) {
        self.edges.clear();
        self.surfaces.clear();
    }
}

/// Finds the features of clouds; buffers are used again.
///
/// Clouds with a ring channel are looked at line by line, by curvature, and so are those whose elevations show the lines
/// ([`LineFinder`]). Others, as down-sampled, merged or deskewed clouds are, rings or not, have no lines to speak of: they are thinned out, and the
/// spread of each point's neighbours tells surface from edge.
///
/// ```
/// use agv_core::{compute::Par, nalgebra::Vector3, sensors::PointCloud};
/// use agv_ndt::loam::{FeatureExtractor, FeatureParams, Features};
///
/// // One laser line that looks into the corner of a room.
/// let beams = (0..900).map(|i| f64::from(i) * 0.4_f64.to_radians());
/// let points = beams.map(|a: f64| (a.cos(), a.sin())).map(|(c, s)| Vector3::new(c, s, 0.0) * (6.0 / c.abs().max(s.abs())));
/// let cloud = PointCloud::from_points(points.map(|p| p.cast())).with_ring(vec![0; 900])?;
/// let mut features = Features::default();
/// FeatureExtractor::new(FeatureParams::default())?.extract_into(&cloud, Par::Seq, &mut features)?;
/// assert!(features.surfaces.len() >= 100);
/// assert!(features.edges.iter().all(|edge| edge.position.norm() > 7.5));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct FeatureExtractor {
    params: FeatureParams,
    finder: LineFinder,
    rings: Vec<u16>,
    /// The cloud with the lines that were found.
    lined: PointCloud,
    image: Option<RangeImage>,
    lines: Vec<Line>,
    neighbourhoods: Neighbourhoods,
}

/// Fewer surface points than this are not what a lidar's lines give.
const FEW: usize = 100;

/// Columns of the image: twice those of a lidar with 0.2° between beams, so that two of them seldom share one.
const COLUMNS: usize = 3600;

/// What is known of a laser line.
#[derive(Debug, Clone, Default)]
struct Line {
    points: Vec<LinePoint>,
    index: Vec<u32>,
    shapes: Vec<(f32, Shape)>,
    order: Vec<u32>,
    edges: Vec<u32>,
    surfaces: Vec<u32>,
}

impl FeatureExtractor {
    /// An extractor with these parameters.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(params: FeatureParams) -> Result<Self, Error> {
        params.validate()?;
        let neighbourhoods = Neighbourhoods::new(params.leaf as f32)?;
        Ok(Self {
            params,
            finder: LineFinder::default(),
            rings: Vec::new(),
            lined: PointCloud::default(),
            image: None,
            lines: Vec::new(),
            neighbourhoods,
        })
    }

    /// Replaces `out` by the features of a cloud. Points that are not finite, too near or too far, are left out. Linear in the points
    /// of a cloud with rings, O(n log n) otherwise.
    ///
    /// # Errors
    /// A cloud of more points or rings than an image of them holds; `out` is then empty.
    pub fn extract_into(&mut self, cloud: &PointCloud, par: Par, out: &mut Features) -> Result<(), Error> {
        out.clear();
        if cloud.ring().is_some() {
            self.extract_lines(cloud, cloud, par, out)?;
            if out.surfaces.len() >= FEW {
                return Ok(());
            }
            // Thinned out, perhaps: rings alone are no lines.
            out.clear();
            return self.neighbourhoods.extract_into(cloud, &self.params, par, out);
        }
        if self.finder.find_into(cloud, &mut self.rings) == 0 {
            return self.neighbourhoods.extract_into(cloud, &self.params, par, out);
        }
        let returns = self.rings.iter().enumerate();
        let returns =
            returns.map(|(i, &ring)| LidarReturn { position: cloud.point(i), ring, ..LidarReturn::default() });
        let mut lined = std::mem::take(&mut self.lined);
        lined.refill(cloud.stamp(), returns);
        let done = self.extract_lines(&lined, cloud, par, out);
        self.lined = lined;
        done
    }

    /// By the lines of `lined`, which is `cloud` with rings.
    fn extract_lines(
        &mut self,
        lined: &PointCloud,
        cloud: &PointCloud,
        par: Par,
        out: &mut Features,
    ) -> Result<(), Error> {
        let ring = lined.ring().unwrap_or_default();
        // What is marked as off all lines is not a line.
        let rows = usize::from(ring.iter().copied().filter(|ring| *ring != u16::MAX).max().unwrap_or(0)) + 1;
        let columns = COLUMNS.min(RangeImage::MAX_CELLS / rows);
        if self.image.as_ref().is_none_or(|image| image.rows() < rows || image.columns() != columns) {
            self.image = Some(RangeImage::new(RangeImageParams { rows, columns, row_source: RowSource::Ring })?);
        }
        let Some(image) = &mut self.image else { return Ok(()) };
        image.fill(lined)?;
        let (image, params) = (&*image, &self.params);
        self.lines.resize_with(image.rows().max(self.lines.len()), Line::default);
        par.for_each_chunk(self.lines.as_mut_slice(), 1, |row, lines| {
            for line in lines {
                line.rebuild(image, row, params);
            }
        });
        let feature = |&index: &u32| {
            let index = index as usize;
            let time = cloud.time().and_then(|time| time.get(index)).copied().unwrap_or(0.0);
            let position = Vector3::new(cloud.x()[index], cloud.y()[index], cloud.z()[index]);
            // A point without time would be anywhere.
            time.is_finite().then_some(Feature { position, time })
        };
        for line in &self.lines {
            out.edges.extend(line.edges.iter().filter_map(feature));
            out.surfaces.extend(line.surfaces.iter().filter_map(feature));
        }
        Ok(())
    }
}

impl Line {
    fn rebuild(&mut self, image: &RangeImage, row: usize, params: &FeatureParams) {
        self.points.clear();
        self.index.clear();
        let (near, far) = (params.min_range as f32, params.max_range as f32);
        let (columns, step) = (image.columns(), std::f32::consts::TAU / image.columns() as f32);
        let ranges = image.ranges().get(row * columns..(row + 1) * columns).unwrap_or_default();
        for (column, &range) in ranges.iter().enumerate() {
            if range >= near && range <= far {
                self.points.push(LinePoint { azimuth: column as f32 * step, range });
                self.index.push(image.point_index(row, column).unwrap_or_default() as u32);
            }
        }
        let bends = CurvatureParams { edge_bend: params.edge_bend as f32, range_sigma: params.range_sigma as f32 };
        shapes_into(&self.points, bends, &mut self.shapes);
        self.edges.clear();
        self.surfaces.clear();
        for sector in 0..SECTORS {
            let bound = |sector: usize| (sector * columns / SECTORS) as f32 * step - 0.5 * step;
            let place = |sector: usize| self.points.partition_point(|point| point.azimuth < bound(sector));
            let span = place(sector)..place(sector + 1);
            self.choose(span.clone(), Shape::Sharp, params.edges_per_sector);
            self.choose(span, Shape::Flat, params.surfaces_per_sector);
        }
    }

    /// Takes up to `quota` points of a shape: the sharpest or the flattest, none a neighbour of another.
    fn choose(&mut self, span: std::ops::Range<usize>, shape: Shape, quota: usize) {
        self.order.clear();
        self.order.extend(span.filter(|&at| self.shapes[at].1 == shape).map(|at| at as u32));
        let sharp = shape == Shape::Sharp;
        let shapes = &self.shapes;
        let by_bend = |a: &u32, b: &u32| {
            let (left, right) = (shapes[*a as usize].0, shapes[*b as usize].0);
            let order = if sharp { right.total_cmp(&left) } else { left.total_cmp(&right) };
            order.then(a.cmp(b))
        };
        // Each that is taken bars up to ten: of so many candidates enough are left.
        let enough = quota * (2 * SIDE + 1);
        if self.order.len() > enough {
            self.order.select_nth_unstable_by(enough, by_bend);
            self.order.truncate(enough);
        }
        self.order.sort_unstable_by(by_bend);
        let mut taken = 0;
        for position in 0..self.order.len() {
            let at = self.order[position] as usize;
            if taken == quota {
                break;
            }
            if self.shapes[at].1 != shape {
                continue;
            }
            let chosen = if sharp { &mut self.edges } else { &mut self.surfaces };
            chosen.push(self.index[at]);
            taken += 1;
            let around = at.saturating_sub(SIDE)..(at + SIDE + 1).min(self.shapes.len());
            self.shapes[around]
                .iter_mut()
                .filter(|(_, other)| *other == shape)
                .for_each(|(_, other)| *other = Shape::None);
        }
    }
}
