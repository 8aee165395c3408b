//! What services keep for a chassis: its registry of handlers, its semaphores, its recorders. The chassis knows
//! none of them by name.

use std::{
    any::{Any, TypeId},
    collections::HashMap,
    sync::{Arc, Mutex},
};

use super::Chassis;
use ctos_message::Tid;
use ctos_time::lock::lock;

/// What a service keeps for one chassis.
pub trait Extension: Any + Send + Sync {
    /// That of a chassis which has none yet.
    fn new(chassis: &Chassis) -> Self
    where
        Self: Sized;

    /// A task of the chassis has ended.
    fn task_ended(&self, chassis: &Arc<Chassis>, task: Tid) {
        let _ = (chassis, task);
    }

    /// The chassis is being ended.
    fn closed(&self) {}
}

/// The extensions of one chassis, one of each type.
#[derive(Default)]
pub(super) struct Extensions(Mutex<HashMap<TypeId, Arc<dyn Extension>>>);

impl Extensions {
    pub(super) fn set<T: Extension>(&self, extension: Arc<T>) {
        lock(&self.0).insert(TypeId::of::<T>(), extension);
    }

    pub(super) fn all(&self) -> Vec<Arc<dyn Extension>> {
        lock(&self.0).values().cloned().collect()
    }

    fn get<T: Extension>(&self) -> Option<Arc<T>> {
        let found: Arc<dyn Any + Send + Sync> = lock(&self.0).get(&TypeId::of::<T>())?.clone();
        found.downcast().ok()
    }
}

#[doc(hidden)]
impl Chassis {
    /// Adds what a service keeps, in place of what it has kept so far.
    pub(crate) fn extend<T: Extension>(&self, extension: Arc<T>) {
        self.extensions.set(extension);
    }

    /// What a service keeps; made now if there is none.
    pub fn extension<T: Extension>(&self) -> Arc<T> {
        if let Some(found) = self.extensions.get() {
            return found;
        }
        // Made outside the lock: it may look at the chassis. Should another thread be first, its own counts.
        let new = Arc::new(T::new(self));
        let mut all = lock(&self.extensions.0);
        let entry = all.entry(TypeId::of::<T>());
        let there: Arc<dyn Any + Send + Sync> = entry.or_insert_with(|| new.clone()).clone();
        there.downcast().unwrap_or(new)
    }
}
