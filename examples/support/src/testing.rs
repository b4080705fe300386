//! What the tests of the readers share: scratch folders, the shared data if it is there, and byte mutations.

use std::{
    fs,
    path::{Path, PathBuf},
};

/// A folder of a test's own, removed at the end.
pub(crate) struct Scratch(PathBuf);

impl Scratch {
    pub(crate) fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("agv-support-{}-{name}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        Self(folder)
    }

    pub(crate) fn folder(&self) -> &Path {
        &self.0
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// A file of the data folder beside the repository; `None`, said on standard error, where it is absent.
pub(crate) fn shared(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data").join(name);
    let present = path.exists();
    if !present {
        eprintln!("skipped: {} is not here", path.display());
    }
    present.then_some(path)
}

/// Feeds a reader every truncation and many single-byte changes of a good file: it may refuse, it may not panic.
pub(crate) fn survives_damage(good: &[u8], mut read: impl FnMut(Vec<u8>)) {
    for cut in 0..good.len() {
        read(good[..cut].to_vec());
    }
    for at in 0..good.len() {
        for byte in [0, b'9', b'-', b'\n', b' ', 0xff, good[at] ^ 1] {
            let mut bytes = good.to_vec();
            bytes[at] = byte;
            read(bytes);
        }
    }
}
