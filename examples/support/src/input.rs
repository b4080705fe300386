//! A file in memory: gzip undone, its name kept for the messages.

use crate::Error;
use flate2::read::MultiGzDecoder;
use std::{
    ffi::OsString,
    fmt::Display,
    fs,
    io::{self, Read as _},
    path::{Path, PathBuf},
};

/// Most bytes that a file may have after decompression: a small archive may claim any size.
pub const MAX_BYTES: u64 = 2 << 30;

/// The content of a file, uncompressed, and its name.
///
/// ```
/// let input = agv_support::Input::new("poses.txt", "1 2 3\nx");
/// let error = input.line_error(2, "`x` is not a number");
/// assert_eq!(error.to_string(), "poses.txt:2: `x` is not a number");
/// ```
#[derive(Debug, Clone)]
pub struct Input {
    path: PathBuf,
    bytes: Vec<u8>,
}

impl Input {
    /// Content that is already in memory and uncompressed, under a name for the messages.
    pub fn new(path: impl Into<PathBuf>, bytes: impl Into<Vec<u8>>) -> Self {
        Self { path: path.into(), bytes: bytes.into() }
    }

    /// Reads `path`, or `path.gz` where there is no `path`; gzip is recognised by its content, not by its name.
    ///
    /// # Errors
    /// The operating system's refusal, a damaged archive, or more than [`MAX_BYTES`].
    pub fn read(path: impl AsRef<Path>) -> Result<Self, Error> {
        let path = path.as_ref();
        let found = locate(path);
        let file = fs::File::open(&found).map_err(|source| match source.kind() {
            io::ErrorKind::NotFound => Error::file(path, "no such file, with or without .gz"),
            _ => Error::io(&found, source),
        })?;
        let mut raw = Vec::new();
        let fault = |source| Error::io(&found, source);
        file.take(MAX_BYTES + 1).read_to_end(&mut raw).map_err(fault)?;
        Self::decompress(found, raw)
    }

    /// Undoes gzip if `raw` is gzip.
    ///
    /// # Errors
    /// A damaged archive, or more than [`MAX_BYTES`].
    pub fn decompress(path: impl Into<PathBuf>, raw: Vec<u8>) -> Result<Self, Error> {
        let path = path.into();
        let bytes = if raw.starts_with(&[0x1f, 0x8b]) {
            let mut bytes = Vec::new();
            MultiGzDecoder::new(raw.as_slice())
                .take(MAX_BYTES + 1)
                .read_to_end(&mut bytes)
                .map_err(|source| Error::file(&path, format_args!("damaged gzip: {source}")))?;
            bytes
        } else {
            raw
        };
        if bytes.len() as u64 > MAX_BYTES {
            return Err(Error::file(&path, format_args!("more than {MAX_BYTES} bytes")));
        }
        Ok(Self { path, bytes })
    }

    /// Name of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Uncompressed content.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// The lines with their numbers from 1, without their ends (LF or CRLF).
    ///
    /// A line that is not UTF-8 is an error in its place.
    pub fn lines(&self) -> impl Iterator<Item = Result<(usize, &str), Error>> {
        // The end of the last line does not begin another one.
        let body = self.bytes.strip_suffix(b"\n").unwrap_or(&self.bytes);
        let lines = body.split(|&b| b == b'\n').enumerate();
        lines.map(|(index, line)| match std::str::from_utf8(line.strip_suffix(b"\r").unwrap_or(line)) {
            Ok(text) => Ok((index + 1, text)),
            Err(_) => Err(self.line_error(index + 1, "not text (UTF-8)")),
        })
    }

    /// The lines that are neither blank nor start with `#`.
    pub fn data_lines(&self) -> impl Iterator<Item = Result<(usize, &str), Error>> {
        self.lines().filter(|line| match line {
            Ok((_, text)) => !text.trim_start().is_empty() && !text.trim_start().starts_with('#'),
            Err(_) => true,
        })
    }

    /// A fault in line `line`, counted from 1.
    pub fn line_error(&self, line: usize, reason: impl Display) -> Error {
        Error::Line { path: self.path.clone(), line, reason: reason.to_string() }
    }

    /// A fault at byte `byte`, counted from 0.
    pub fn byte_error(&self, byte: usize, reason: impl Display) -> Error {
        Error::Byte { path: self.path.clone(), byte, reason: reason.to_string() }
    }

    /// A fault of the whole file.
    pub fn file_error(&self, reason: impl Display) -> Error {
        Error::file(&self.path, reason)
    }
}

/// `path` if it exists or has no gzipped sibling, else `path.gz`.
fn locate(path: &Path) -> PathBuf {
    let mut zipped = OsString::from(path);
    zipped.push(".gz");
    let zipped = PathBuf::from(zipped);
    if !path.exists() && zipped.exists() { zipped } else { path.to_owned() }
}

/// Writes a file, gzipped if its name ends in `.gz`; missing folders are made.
///
/// # Errors
/// The operating system's refusal.
pub fn write(path: impl AsRef<Path>, bytes: &[u8]) -> Result<(), Error> {
    let path = path.as_ref();
    let fault = |source| Error::io(path, source);
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        fs::create_dir_all(folder).map_err(|source| Error::io(folder, source))?;
    }
    if path.extension().is_some_and(|extension| extension == "gz") {
        use flate2::{Compression, GzBuilder};
        // No time stamp in the header: the same content gives the same file.
        let file = io::BufWriter::new(fs::File::create(path).map_err(fault)?);
        let mut encoder = GzBuilder::new().mtime(0).write(file, Compression::best());
        io::Write::write_all(&mut encoder, bytes).map_err(fault)?;
        let mut file = encoder.finish().map_err(fault)?;
        io::Write::flush(&mut file).map_err(fault)
    } else {
        fs::write(path, bytes).map_err(fault)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Scratch;

    #[test]
    fn gzip_is_known_by_content_and_found_beside_the_name() {
        let scratch = Scratch::new("input");
        write(scratch.path("a.txt.gz"), b"hello").unwrap();
        assert_eq!(Input::read(scratch.path("a.txt")).unwrap().bytes(), b"hello");
        fs::rename(scratch.path("a.txt.gz"), scratch.path("b.txt")).unwrap();
        assert_eq!(Input::read(scratch.path("b.txt")).unwrap().bytes(), b"hello");
    }

    #[test]
    fn absent_and_damaged_files_are_named() {
        let scratch = Scratch::new("input-bad");
        let absent = Input::read(scratch.path("absent.csv")).unwrap_err().to_string();
        assert!(absent.contains("absent.csv") && absent.contains("no such file"), "{absent}");
        write(scratch.path("cut.gz"), &[7; 4000]).unwrap();
        let whole = fs::read(scratch.path("cut.gz")).unwrap();
        fs::write(scratch.path("cut.gz"), &whole[..whole.len() - 5]).unwrap();
        assert!(Input::read(scratch.path("cut.gz")).unwrap_err().to_string().contains("damaged gzip"));
        assert!(matches!(Input::read(scratch.folder()), Err(Error::Io { .. })));
    }

    #[test]
    fn lines_end_in_either_way_and_are_counted() {
        let input = Input::new("f", "a\r\n# c\n\nb");
        let lines: Vec<_> = input.data_lines().map(Result::unwrap).collect();
        assert_eq!(lines, [(1, "a"), (4, "b")]);
    }
}
