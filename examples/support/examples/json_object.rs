//! Exits with 0 if standard input is one JSON object with fields, among them those that the arguments name (as JSON pointers
//! without the first slash: `rmse_m`, `runs/0/rmse_m`), and nothing else; used by `.ci/run` on what examples print.

use agv_support::Error;
use std::{env, io::Read as _, path::Path, process::ExitCode};

fn main() -> ExitCode {
    agv_support::run(|| {
        let mut text = String::new();
        let stdin = Path::new("standard input");
        std::io::stdin().read_to_string(&mut text).map_err(|source| Error::io(stdin, source))?;
        let object = match serde_json::from_str::<serde_json::Value>(&text) {
            Ok(value) if value.as_object().is_some_and(|fields| !fields.is_empty()) => value,
            Ok(_) => return Err(Error::file(stdin, "JSON, but not an object with fields")),
            Err(error) => return Err(Error::file(stdin, error)),
        };
        let missing: Vec<String> =
            env::args().skip(1).filter(|key| object.pointer(&format!("/{key}")).is_none()).collect();
        if missing.is_empty() { Ok(()) } else { Err(Error::file(stdin, format!("no {}", missing.join(", ")))) }
    })
}
