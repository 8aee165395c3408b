//! What survives a process in virtual time: files of the simulated host, as values in memory.
//!
//! In real time a task that must survive its process writes to the file system. In virtual time all
//! chassis of a run share one of these instead. It belongs to the run, not to a chassis. So a
//! restarted chassis finds what its predecessor left there, and no run sees the files of another.

use std::{
    any::Any,
    collections::BTreeMap,
    ffi::OsString,
    path::Path,
    sync::{Arc, Mutex},
};

use crate::{
    chassis::{Chassis, Extension},
    context::Context,
};
use ctos_time::lock::lock;

/// The files of a simulated host.
#[derive(Default, derive_more::Debug)]
#[debug("Disk({} files)", lock(&self.files).len())]
pub struct Disk {
    /// By the bytes of their paths: files are many, and to compare paths part by part takes long.
    files: Mutex<BTreeMap<OsString, Arc<dyn Any + Send + Sync>>>,
}

impl Disk {
    /// The file at `path`, made empty if there is none. What a file is depends on who opens it first;
    /// `None` when that was another kind of file.
    #[must_use]
    pub fn open<T: Default + Send + Sync + 'static>(&self, path: &Path) -> Option<Arc<T>> {
        let mut files = lock(&self.files);
        if let Some(file) = files.get(path.as_os_str()) {
            return file.clone().downcast().ok();
        }
        let file = Arc::<T>::default();
        files.insert(path.into(), file.clone());
        Some(file)
    }
}

/// The disk of a chassis, if it is simulated.
struct OnDisk(Option<Arc<Disk>>);

impl Extension for OnDisk {
    fn new(_: &Chassis) -> Self {
        Self(None)
    }
}

impl Chassis {
    /// What survives it, if it is simulated.
    pub fn disk(&self) -> Option<Arc<Disk>> {
        self.extension::<OnDisk>().0.clone()
    }
}

#[doc(hidden)]
impl Chassis {
    /// It is simulated, and this survives it.
    pub fn set_disk(&self, disk: Arc<Disk>) {
        self.extend(Arc::new(OnDisk(Some(disk))));
    }
}

impl Context {
    /// The disk of the simulated host; `None` in real time, where there is the file system.
    #[must_use]
    pub fn disk(&self) -> Option<Arc<Disk>> {
        self.chassis().disk()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_the_same_for_all_who_open_it_as_what_it_is() {
        let disk = Disk::default();
        let file: Arc<Mutex<u32>> = disk.open(Path::new("a")).unwrap();
        *lock(&file) = 7;
        let again: Arc<Mutex<u32>> = disk.open(Path::new("a")).unwrap();
        assert_eq!(*lock(&again), 7);
        assert!(disk.open::<Mutex<String>>(Path::new("a")).is_none());
        let other: Arc<Mutex<u32>> = disk.open(Path::new("b")).unwrap();
        assert_eq!(*lock(&other), 0);
    }
}
