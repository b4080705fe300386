//! What the tables check.

use serde::{Serialize, de::DeserializeOwned};
use serde_json::Value;

/// A value by way of its text.
pub(crate) fn restored<T: Serialize + DeserializeOwned>(value: &T) -> T {
    let text = serde_json::to_string(value).unwrap();
    serde_json::from_str(&text).unwrap_or_else(|error| panic!("{error}: {text:.300}"))
}

/// The value that comes back writes the same text. The texts of two numbers differ wherever their bits do.
pub(crate) fn assert_kept<T: Serialize + DeserializeOwned>(name: &str, value: &T) {
    let [before, after] = [value, &restored(value)].map(|v| serde_json::to_string(v).unwrap());
    assert!(before == after, "{name}: {before:.300} came back as {after:.300}");
}

/// Each replacement of the entry at a JSON pointer makes a text that is refused.
pub(crate) fn assert_refused<T: Serialize + DeserializeOwned>(
    name: &str,
    value: &T,
    spoilt: &[(impl AsRef<str>, Value)],
) {
    let good = serde_json::to_value(value).unwrap();
    assert!(serde_json::from_value::<T>(good.clone()).is_ok(), "{name}");
    for (pointer, entry) in spoilt {
        let pointer = pointer.as_ref();
        let mut bad = good.clone();
        *bad.pointer_mut(pointer).unwrap_or_else(|| panic!("{name} has no {pointer}: {good}")) = entry.clone();
        assert!(serde_json::from_value::<T>(bad).is_err(), "{name} with {entry} at {pointer}");
    }
}

#[test]
fn the_table_sees_lost_bits() {
    // Numbers that are not finite are lost in JSON unless a type looks after them.
    assert!(std::panic::catch_unwind(|| assert_kept("infinity", &f64::INFINITY)).is_err());
    assert!(std::panic::catch_unwind(|| assert_refused("a number", &1.0, &[("", Value::from(2.0))])).is_err());
    assert_kept("pi", &std::f64::consts::PI);
    assert_ne!(serde_json::to_string(&-0.0).unwrap(), serde_json::to_string(&0.0).unwrap());
}
