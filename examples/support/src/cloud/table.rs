//! Rows of named numbers, from which a cloud is assembled.

use crate::{Error, Input};
use agv_core::{sensors::PointCloud, time::Stamp};

/// How a number is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Scalar {
    pub(super) const fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    const fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }

    /// The number in the first bytes; none if they are too few.
    pub(super) fn decode(self, bytes: &[u8], big_endian: bool) -> Option<f64> {
        let mut le = [0_u8; 8];
        let size = self.size();
        le[..size].copy_from_slice(bytes.get(..size)?);
        if big_endian {
            le[..size].reverse();
        }
        let word = u64::from_le_bytes(le);
        Some(match self {
            Self::I8 => f64::from(word as u8 as i8),
            Self::U8 => f64::from(word as u8),
            Self::I16 => f64::from(word as u16 as i16),
            Self::U16 => f64::from(word as u16),
            Self::I32 => f64::from(word as u32 as i32),
            Self::U32 => f64::from(word as u32),
            Self::I64 => word as i64 as f64,
            Self::U64 => word as f64,
            Self::F32 => f64::from(f32::from_bits(word as u32)),
            Self::F64 => f64::from_bits(word),
        })
    }
}

/// A named column.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Column {
    pub(super) name: String,
    pub(super) scalar: Scalar,
}

/// Which columns make up a cloud, and the cloud as far as it was read.
pub(super) struct Builder {
    position: [usize; 3],
    intensity: Option<usize>,
    ring: Option<usize>,
    /// Column of the time, and the seconds that one unit of it is.
    time: Option<(usize, f64)>,
    xyz: [Vec<f32>; 3],
    intensities: Vec<f32>,
    rings: Vec<u16>,
    /// Seconds, of a day or of an epoch.
    times: Vec<f64>,
}

/// Times beyond this are no offsets within a sweep, in seconds.
const LONGEST_SWEEP: f64 = 1000.0;

impl Builder {
    /// Finds x, y, z and the optional channels by the names that the field's tools give them.
    ///
    /// Times of an integer type are nanoseconds, others seconds.
    pub(super) fn new(input: &Input, columns: &[Column]) -> Result<Self, Error> {
        let find = |names: &[&str]| columns.iter().position(|column| names.contains(&column.name.as_str()));
        let axis = |name: &'static str| {
            find(&[name]).ok_or_else(|| input.file_error(format_args!("the points have no `{name}`")))
        };
        let time = find(&["time", "t", "time_offset", "offset_time", "timestamp"])
            .map(|at| (at, if columns[at].scalar.is_float() { 1.0 } else { 1e-9 }));
        Ok(Self {
            position: [axis("x")?, axis("y")?, axis("z")?],
            intensity: find(&["intensity", "i", "reflectivity", "remission", "scalar_Intensity"]),
            ring: find(&["ring", "line", "laser_number", "channel"]),
            time,
            xyz: [const { Vec::new() }; 3],
            intensities: Vec::new(),
            rings: Vec::new(),
            times: Vec::new(),
        })
    }

    /// Adds a point; `row` has a number per column.
    pub(super) fn push(&mut self, row: &[f64]) {
        for (axis, at) in self.xyz.iter_mut().zip(self.position) {
            axis.push(row[at] as f32);
        }
        if let Some(at) = self.intensity {
            self.intensities.push(row[at] as f32);
        }
        if let Some(at) = self.ring {
            self.rings.push(row[at] as u16);
        }
        if let Some((at, unit)) = self.time {
            self.times.push(row[at] * unit);
        }
    }

    pub(super) fn finish(self) -> Result<PointCloud, Error> {
        let [x, y, z] = self.xyz;
        let mut cloud = PointCloud::new(x, y, z)?;
        if self.intensity.is_some() {
            cloud = cloud.with_intensity(self.intensities)?;
        }
        if self.ring.is_some() {
            cloud = cloud.with_ring(self.rings)?;
        }
        if self.time.is_some() {
            // Times of an epoch do not fit an f32: the cloud's stamp takes the first.
            let first = self.times.first().copied().filter(|time| time.abs() > LONGEST_SWEEP).unwrap_or(0.0);
            cloud = cloud.with_time(self.times.iter().map(|time| (time - first) as f32).collect())?;
            cloud = cloud.with_stamp(Stamp::from_seconds(first));
        }
        Ok(cloud)
    }
}

/// The columns that a cloud is written with, and a function that gives each point's numbers.
pub(super) fn columns_of(cloud: &PointCloud) -> Vec<Column> {
    let column = |name: &str, scalar| Column { name: name.into(), scalar };
    let mut columns: Vec<Column> = ["x", "y", "z"].into_iter().map(|name| column(name, Scalar::F32)).collect();
    columns.extend(cloud.intensity().map(|_| column("intensity", Scalar::F32)));
    columns.extend(cloud.ring().map(|_| column("ring", Scalar::U16)));
    columns.extend(cloud.time().map(|_| column("time", Scalar::F32)));
    columns
}

/// Writes the points row by row, as text or little-endian bytes, in the order of [`columns_of`].
pub(super) fn write_rows(cloud: &PointCloud, encoding: super::Encoding, out: &mut Vec<u8>) {
    use std::io::Write as _;
    let channel = |values: Option<&[f32]>, index: usize| values.map(|values| values[index]);
    for (index, point) in cloud.points().enumerate() {
        let ring = cloud.ring().map(|ring| ring[index]);
        let before = [Some(point.x), Some(point.y), Some(point.z), channel(cloud.intensity(), index)];
        let after = channel(cloud.time(), index);
        match encoding {
            super::Encoding::Binary => {
                before.into_iter().flatten().for_each(|value| out.extend(value.to_le_bytes()));
                out.extend(ring.into_iter().flat_map(u16::to_le_bytes));
                out.extend(after.into_iter().flat_map(f32::to_le_bytes));
            }
            super::Encoding::Ascii => {
                let text = |value: f32| value.to_string();
                let fields = before.into_iter().flatten().map(text).chain(ring.map(|ring| ring.to_string()));
                let fields: Vec<String> = fields.chain(after.map(text)).collect();
                // Writing to memory cannot fail.
                let _ = writeln!(out, "{}", fields.join(" "));
            }
        }
    }
}
