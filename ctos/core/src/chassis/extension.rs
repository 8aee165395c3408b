//! What services keep for a chassis: its registry of handlers, its semaphores, its recorders. The chassis knows
//! none of them by name.

use std::{
    any::{Any, TypeId},
    collections::BTreeMap,
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
pub(super) type Extensions = Mutex<BTreeMap<TypeId, Arc<dyn Extension>>>;

#[doc(hidden)]
impl Chassis {
    pub(super) fn extensions(&self) -> Vec<Arc<dyn Extension>> {
        lock(&self.extensions).values().cloned().collect()
    }

    /// Adds what a service keeps, in place of what it has kept so far.
    pub(crate) fn extend<T: Extension>(&self, extension: Arc<T>) {
        lock(&self.extensions).insert(TypeId::of::<T>(), extension);
    }

    /// What a service keeps; made now if there is none.
    pub fn extension<T: Extension>(&self) -> Arc<T> {
        let id = TypeId::of::<T>();
        let there = lock(&self.extensions).get(&id).cloned();
        let there: Arc<dyn Any + Send + Sync> = match there {
            Some(there) => there,
            None => {
                // Made outside the lock: it may look at the chassis. Should another thread be first, its own counts.
                let new = Arc::new(T::new(self));
                lock(&self.extensions).entry(id).or_insert(new).clone()
            }
        };
        // It is a `T`, or it would not be found there.
        there.downcast().unwrap_or_else(|_| Arc::new(T::new(self)))
    }
}
