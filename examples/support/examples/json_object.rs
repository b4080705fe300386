//! Exits with 0 if standard input is one JSON object and nothing else; used by `.ci/run` on what examples print.

use agv_support::Error;
use std::{io::Read as _, path::Path, process::ExitCode};

fn main() -> ExitCode {
    agv_support::run(|| {
        let mut text = String::new();
        let stdin = Path::new("standard input");
        std::io::stdin().read_to_string(&mut text).map_err(|source| Error::io(stdin, source))?;
        match serde_json::from_str::<serde_json::Value>(&text) {
            Ok(serde_json::Value::Object(fields)) if !fields.is_empty() => Ok(()),
            Ok(_) => Err(Error::file(stdin, "JSON, but not an object with fields")),
            Err(error) => Err(Error::file(stdin, error)),
        }
    })
}
