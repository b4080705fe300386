//! Readings in stored form.
//!
//! A scan holds +∞ (no return) and NaN (no statement), a cloud NaN. JSON and its like have no number for them and write
//! `null`, which does not come back. So in formats for humans they are the words `"inf"`, `"-inf"` and `"nan"`; all else
//! is a number, as everything is in binary formats. For fields, by `serde(with = "crate::stored_readings")`.

use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{Error, Unexpected, Visitor},
};
use std::fmt;

/// One reading.
struct Reading(f32);

impl Serialize for Reading {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let value = self.0;
        if !serializer.is_human_readable() {
            serializer.serialize_f32(value)
        } else if value.is_nan() {
            serializer.serialize_str("nan")
        } else if value.is_infinite() {
            serializer.serialize_str(if value > 0.0 { "inf" } else { "-inf" })
        } else if value.abs() < 1e-20 {
            // Read back as f64, the shortest text of 7.038531e-26 rounds to its neighbour (of all f32 it alone does).
            serializer.serialize_f64(f64::from(value))
        } else {
            serializer.serialize_f32(value)
        }
    }
}

impl<'de> Deserialize<'de> for Reading {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        if deserializer.is_human_readable() {
            deserializer.deserialize_any(ReadingVisitor)
        } else {
            f32::deserialize(deserializer).map(Self)
        }
    }
}

struct ReadingVisitor;

impl Visitor<'_> for ReadingVisitor {
    type Value = Reading;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("a number of single precision, \"inf\", \"-inf\" or \"nan\"")
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<Reading, E> {
        let single = value as f32;
        let fits = single.is_finite() || !value.is_finite();
        if fits { Ok(Reading(single)) } else { Err(E::invalid_value(Unexpected::Float(value), &self)) }
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<Reading, E> {
        Ok(Reading(value as f32))
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<Reading, E> {
        Ok(Reading(value as f32))
    }

    fn visit_str<E: Error>(self, value: &str) -> Result<Reading, E> {
        match value {
            "inf" => Ok(Reading(f32::INFINITY)),
            "-inf" => Ok(Reading(f32::NEG_INFINITY)),
            "nan" => Ok(Reading(f32::NAN)),
            _ => Err(E::invalid_value(Unexpected::Str(value), &self)),
        }
    }
}

pub(crate) fn serialize<S: Serializer>(values: &[f32], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(values.iter().map(|&value| Reading(value)))
}

pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f32>, D::Error> {
    Ok(floats(Vec::deserialize(deserializer)?))
}

fn floats(readings: Vec<Reading>) -> Vec<f32> {
    readings.into_iter().map(|reading| reading.0).collect()
}

/// The same for a channel that may be missing.
pub(crate) mod optional {
    use super::{Deserialize, Deserializer, Reading, Serialize, Serializer, floats};

    struct Readings<'a>(&'a [f32]);

    impl Serialize for Readings<'_> {
        fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
            super::serialize(self.0, serializer)
        }
    }

    #[expect(clippy::ref_option, reason = "the signature that serde calls")]
    pub(crate) fn serialize<S: Serializer>(values: &Option<Vec<f32>>, serializer: S) -> Result<S::Ok, S::Error> {
        values.as_deref().map(Readings).serialize(serializer)
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Vec<f32>>, D::Error> {
        Ok(Option::<Vec<Reading>>::deserialize(deserializer)?.map(floats))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn keep(value: f32) -> f32 {
        serde_json::from_str::<Reading>(&serde_json::to_string(&Reading(value)).unwrap()).unwrap().0
    }

    proptest! {
        #[test]
        fn every_number_keeps_its_bits(bits in any::<u32>()) {
            let value = f32::from_bits(bits);
            prop_assert!(keep(value).to_bits() == bits || (value.is_nan() && keep(value).is_nan()));
        }
    }

    #[test]
    fn special_numbers_keep_their_bits() {
        for value in
            [7.038_531e-26, -0.0, f32::MAX, f32::MIN_POSITIVE, 1e-45, f32::INFINITY, f32::NEG_INFINITY, f32::NAN]
        {
            assert_eq!(keep(value).to_bits(), value.to_bits(), "{value}");
        }
    }

    #[test]
    fn what_is_no_reading_is_refused() {
        for text in ["null", "\"far\"", "1e39", "true", "[1.0]"] {
            assert!(serde_json::from_str::<Reading>(text).is_err(), "{text}");
        }
        assert_eq!(serde_json::from_str::<Reading>("3").unwrap().0, 3.0);
    }
}
