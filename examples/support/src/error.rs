//! What can be wrong with a file, said so that a user can mend it; and how an example ends.

use std::{
    fmt::Display,
    io::{self, Write as _},
    path::{Path, PathBuf},
    process::ExitCode,
};

/// Why a file could not be read or written: its name, the place, the reason.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// What the operating system says.
        source: io::Error,
    },
    /// A line of a text file is wrong.
    #[error("{}:{line}: {reason}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Line, counted from 1.
        line: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// A byte of a binary file is wrong, or the file ends there.
    #[error("{}: byte {byte}: {reason}", path.display())]
    Byte {
        /// The file.
        path: PathBuf,
        /// Offset in the uncompressed content, from 0.
        byte: usize,
        /// What is wrong there.
        reason: String,
    },
    /// A file as a whole is wrong.
    #[error("{}: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// Values that the library refuses.
    #[error(transparent)]
    Core(#[from] agv_core::Error),
}

impl Error {
    /// The operating system's refusal of `path`.
    pub fn io(path: &Path, source: io::Error) -> Self {
        Self::Io { path: path.to_owned(), source }
    }

    /// A fault of the whole file.
    pub fn file(path: &Path, reason: impl Display) -> Self {
        Self::File { path: path.to_owned(), reason: reason.to_string() }
    }
}

/// Runs an example: an error becomes one line on standard error and exit code 1, never a panic or a backtrace.
///
/// ```no_run
/// fn main() -> std::process::ExitCode {
///     agv_support::run(|| {
///         let log = agv_support::log::ScanLog::read("scans.csv")?;
///         println!("{} scans", log.entries.len());
///         Ok::<(), agv_support::Error>(())
///     })
/// }
/// ```
pub fn run<E: Display>(example: impl FnOnce() -> Result<(), E>) -> ExitCode {
    match example() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            complain(&error);
            ExitCode::FAILURE
        }
    }
}

/// Runs an example that judges what it sees: exit code 0 if all is as it should be, 1 if not, and 2 with one line on standard
/// error, as for bad arguments, if there was nothing to judge.
///
/// ```
/// # use std::process::ExitCode;
/// let code = agv_support::judge(|| Ok::<bool, agv_support::Error>(2 + 2 == 5));
/// assert_eq!(code, ExitCode::from(1));
/// ```
pub fn judge<E: Display>(example: impl FnOnce() -> Result<bool, E>) -> ExitCode {
    match example() {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            complain(&error);
            ExitCode::from(2)
        }
    }
}

/// Says what is wrong, in one line.
fn complain(error: &impl Display) {
    // A message of several lines (from a parser) is folded into one; a closed standard error is no reason to panic.
    let message = error.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
    let _ = writeln!(io::stderr(), "error: {message}");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_message_names_file_place_and_reason() {
        let path = PathBuf::from("a.log");
        let line = Error::Line { path: path.clone(), line: 3, reason: "`x` is not a number".into() };
        assert_eq!(line.to_string(), "a.log:3: `x` is not a number");
        let byte = Error::Byte { path, byte: 12, reason: "the file ends".into() };
        assert_eq!(byte.to_string(), "a.log: byte 12: the file ends");
    }
}
