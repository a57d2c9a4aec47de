//! WebAssembly, which has no host, no signals and no programs.

#[cfg(feature = "files")]
pub(crate) fn host_name() -> String {
    "wasm".into()
}

#[cfg(feature = "cli")]
pub(crate) fn cpu_seconds() -> Option<f64> {
    None
}

#[cfg(feature = "files")]
pub(crate) mod directory {
    use std::fs::File;
    use std::io;
    use std::path::Path;

    use crate::os::by_path;

    pub(crate) use by_path::{
        Handle, create_dir, hard_link, is_at, is_link, open, open_inner, remove, rename, sync,
    };

    pub(crate) fn open_file(directory: &Handle, path: &Path) -> io::Result<File> {
        by_path::open_file(&mut File::options(), directory, path)
    }

    pub(crate) fn create_file(directory: &Handle, path: &Path) -> io::Result<File> {
        by_path::create_file(&mut File::options(), directory, path)
    }

    pub(crate) fn lock(_: &File) -> io::Result<()> {
        Ok(())
    }

    pub(crate) fn open_shared(path: &Path) -> io::Result<File> {
        File::open(path)
    }
}
