//! The process of one chassis: connects to the others, runs its processors until it is told to end.

use std::{
    cell::Cell,
    os::fd::AsFd,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use tokio::{io::AsyncReadExt, net::unix::pipe, sync::oneshot};

use crate::boot::mesh::{self, FLUSH_TIMEOUT, Identification, Mesh, MeshEvent};
use ctos_bootstrap::watch;
use ctos_config::App;
use ctos_core::{chassis::Chassis, registry::Registry};
use ctos_link::{handshake::Token, transport::Address};
use ctos_message::ChassisNumber;
use ctos_time::{Clock, Lease};

/// Why a chassis could not start.
#[derive(Debug, thiserror::Error)]
pub enum ChildError {
    /// The configuration has no such chassis.
    #[error("the configuration has no chassis `{0}`")]
    Unknown(String),
    /// It could not be connected.
    #[error("cannot connect to {what}: {reason}")]
    Connect {
        /// To whom.
        what: String,
        /// Why not.
        reason: String,
    },
    /// It can have no links.
    #[error("{0}")]
    Links(String),
    /// The system refused a thread or a timer.
    #[error("cannot start: {0}")]
    System(#[from] std::io::Error),
}

/// Why a chassis ends that an agent no longer holds.
const UNTETHERED: &str = "the agent that started this chassis is gone, or has ended its run";

/// Runs chassis `name` of `app` until the boot at `boot` tells it to end, or is gone.
/// Returns the process's exit code.
///
/// # Errors
/// [`ChildError`] when it cannot be connected; the boot is told, if it can be reached.
pub fn run_chassis(
    app: App,
    registry: Registry,
    name: &str,
    boot: &Address,
    origin_ns: u64,
) -> Result<i32, ChildError> {
    let app = Arc::new(app);
    let index = app
        .place_of_chassis(name)
        .and_then(|position| ChassisNumber::try_from(position + 1).ok())
        .ok_or_else(|| ChildError::Unknown(name.to_owned()))?;
    let token = Token(std::env::var(crate::boot::launcher::TOKEN_VARIABLE).unwrap_or_default());
    let clock = Clock::real_from(origin_ns).leased(lease(app.links.peer_timeout));
    let chassis = Chassis::new(index, app, Arc::new(registry), clock);
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    let incarnation = std::env::var(crate::boot::launcher::INCARNATION_VARIABLE).ok();
    let incarnation = incarnation.and_then(|text| text.parse().ok()).unwrap_or(1);
    let who = Identification { token, incarnation };
    let recording = ctos_record::start(std::slice::from_ref(&chassis), watch::COMMANDS)?;
    let code = runtime.block_on(serve(&chassis, boot, who));
    runtime.shutdown_background();
    if let Some(recording) = recording {
        recording.finish();
    }
    code
}

thread_local! {
    /// Whether this thread is just telling that the process was given up.
    static TELLS: Cell<bool> = const { Cell::new(false) };
}

/// The lease of a chassis's process: one that is frozen for longer than `peer_timeout` is given up by the others, who go on
/// without it. It ends when it thaws, before any of its handlers does something in the belief that nothing has happened.
fn lease(peer_timeout: Duration) -> Lease {
    let told = AtomicBool::new(false);
    Lease::new(peer_timeout, move |frozen| {
        // Who tells may look at the clock.
        if TELLS.get() {
            return;
        }
        if told.swap(true, Ordering::AcqRel) {
            // Another thread tells; it may want what this one holds.
            std::thread::sleep(FLUSH_TIMEOUT);
        } else {
            TELLS.set(true);
            let why = match frozen {
                Some(frozen) => format!("frozen for {:.1} s", frozen.as_secs_f64()),
                None => "the boot says that nothing was heard for too long".to_owned(),
            };
            let limit = peer_timeout.as_secs_f64();
            tracing::error!("given up: {why}, peer_timeout_s = {limit}: this chassis ends");
        }
        std::process::exit(mesh::EXIT_GIVEN_UP);
    })
}

async fn serve(
    chassis: &Arc<Chassis>,
    boot: &Address,
    who: Identification,
) -> Result<i32, ChildError> {
    let (sender, mut exited) = oneshot::channel();
    chassis.set_on_exit(move |code| {
        // The receiver lives as long as this function.
        let _ = sender.send(code);
    });
    ctos_bootstrap::bootstrap::start_system_tasks(chassis, None);
    let timeout = chassis.app.phase_timeout;
    let mut tether = Tether::taken()?;
    let connected = tokio::select! {
        connected = tokio::time::timeout(timeout, connect(chassis, boot, who)) => connected,
        () = tether.cut() => return Err(unconnected("the app", UNTETHERED)),
    };
    let mut mesh = connected.map_err(|_| {
        let late = format!("not done within {:.3} s", timeout.as_secs_f64());
        unconnected("the other chassis", late)
    })??;
    let threads = ctos_core::threads::start_processors(chassis)?;
    let code = loop {
        tokio::select! {
            // Without a sender left, every chassis thread is gone: an error exit.
            code = &mut exited => break code.unwrap_or(1),
            () = tether.cut() => {
                tracing::error!("{UNTETHERED}");
                // Its tasks are stopped as when the boot is gone.
                chassis.link_down(0);
            }
            // What becomes of the others, the tasks see.
            _ = mesh.next() => {}
        }
    };
    // The last frames go out.
    chassis.drop_links();
    mesh.close().await;
    chassis.stop_processors();
    // A processor that is stuck in a handler must not keep the process; it ends with it.
    let ended = futures_util::future::join_all(threads);
    let _ = tokio::time::timeout(FLUSH_TIMEOUT, ended).await;
    Ok(code)
}

/// The hold that an agent has on the chassis that it started: their standard input, which ends with it.
struct Tether(Option<pipe::Receiver>);

impl Tether {
    /// That of this process, if an agent started it.
    fn taken() -> std::io::Result<Self> {
        if std::env::var_os(crate::boot::launcher::TETHER_VARIABLE).is_none() {
            return Ok(Self(None));
        }
        let input = std::io::stdin().as_fd().try_clone_to_owned()?;
        Ok(Self(Some(pipe::Receiver::from_owned_fd(input)?)))
    }

    /// Ends, once, when the agent lets go.
    async fn cut(&mut self) {
        let Some(input) = &mut self.0 else {
            return std::future::pending().await;
        };
        let mut ignored = [0; 64];
        while let Ok(1..) = input.read(&mut ignored).await {}
        self.0 = None;
    }
}

/// Connects to the boot, and hears from it who else belongs to the app.
async fn connect(
    chassis: &Arc<Chassis>,
    boot: &Address,
    who: Identification,
) -> Result<Mesh, ChildError> {
    let token = who.token.clone();
    let mut mesh = match Mesh::start(chassis, who).await {
        Ok(mesh) => mesh,
        Err(error) => {
            let error = ChildError::Links(error.to_string());
            // Without usable keys it cannot say so; the boot sees the process end.
            let keys = mesh::keys_of(&chassis.app).ok().flatten();
            mesh::unable(boot, chassis, keys.as_ref(), &token, &error.to_string()).await;
            return Err(error);
        }
    };
    mesh.join(boot);
    loop {
        match mesh.next().await {
            MeshEvent::Joined { .. } => return Ok(mesh),
            // Another chassis that goes is the boot's affair; without the boot there is no app.
            MeshEvent::Down {
                chassis: 0, reason, ..
            } => return Err(unconnected(&format!("the boot at {boot}"), reason)),
            _ => {}
        }
    }
}

fn unconnected(what: &str, reason: impl ToString) -> ChildError {
    ChildError::Connect {
        what: what.to_owned(),
        reason: reason.to_string(),
    }
}
