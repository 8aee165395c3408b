//! The threads of a chassis in real time: one for each processor.

use std::{
    num::NonZeroUsize,
    sync::{Arc, Mutex, mpsc},
};

use tokio::sync::oneshot;

use crate::{
    chassis::Chassis,
    realtime::{self, Grant},
};
use ctos_time::lock::lock;

/// Starts a thread for each processor of `chassis`. When it returns, the chassis knows what the system granted to each
/// ([`Chassis::realtime`]). The receivers end, one way or the other, when their threads have dropped everything that
/// they ran.
///
/// # Errors
/// When the system refuses a thread; those that were started are stopped.
pub fn start_processors(chassis: &Arc<Chassis>) -> std::io::Result<Vec<oneshot::Receiver<()>>> {
    let configs =
        || (0..chassis.processors.len()).filter_map(|index| chassis.processor_config(index));
    let memory = if configs().any(|config| config.realtime) {
        realtime::lock_memory()
    } else {
        Grant::NotAsked
    };
    let cpus = std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
    let mut threads = Vec::new();
    let (prepared, grants) = mpsc::channel();
    // Nothing runs before the chassis knows what was granted: the agent asks for that.
    let gate = Arc::new(Mutex::new(()));
    let closed = lock(&gate);
    for (index, (name, handle)) in chassis.processors.iter().enumerate() {
        if let Some(config) = chassis.processor_config(index) {
            handle.set_spin(ctos_config::placement::spin(&chassis.app, config, cpus));
            handle.set_shares_core(ctos_config::placement::shares(&chassis.app, config, cpus));
        }
        let (home, memory, prepared) = (chassis.clone(), memory.clone(), prepared.clone());
        let gate = gate.clone();
        let (ending, ended) = oneshot::channel::<()>();
        let started = std::thread::Builder::new()
            .name(format!("{}/{name}", chassis.name()))
            .spawn(move || {
                let _ending = ending;
                let config = home.processor_config(index);
                let grant = realtime::prepare_thread(home.name(), config, &memory);
                // Nobody listens when another thread could not be had.
                let _ = prepared.send((index, grant));
                drop(prepared);
                drop(lock(&gate));
                if let Some(processor) = home.processor(index) {
                    if let Some(place) = home.park_of(index) {
                        processor.handle.parker.set(place);
                    }
                    drop(home);
                    processor.run();
                }
            });
        if let Err(error) = started {
            chassis.stop_processors();
            return Err(error);
        }
        threads.push(ended);
    }
    drop(prepared);
    let mut grants: Vec<_> = grants.iter().collect();
    grants.sort_by_key(|(index, _)| *index);
    let configured = grants.into_iter().map(|(_, grant)| grant);
    // The first belongs to the runtime, which asks for nothing.
    chassis.set_realtime(configured.skip(1).inspect(|grant| grant.log()).collect());
    drop(closed);
    Ok(threads)
}
