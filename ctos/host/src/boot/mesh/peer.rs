//! One peer of a mesh: who takes what its session brings, who looks after the session, and who sees its
//! process end.

use std::sync::{Arc, Weak};

use rustix::process::{Pid, PidfdFlags, pidfd_open};
use tokio::io::{Interest, unix::AsyncFd};

use super::{Inner, MeshEvent};
use ctos_link::session::{
    DownReason, Receiver, Session,
    state::{Event, State},
};
use ctos_message::{ChassisNumber, frame::Frame};
use ctos_time::{Clock, Instant, lock::lock};

/// Exit code of a chassis that the boot has given up: it was silent for too long.
pub(crate) const EXIT_GIVEN_UP: i32 = 6;

/// Looks after a session until it is over. For that with the boot `clock` is given: each sign of life that goes there
/// extends the lease of this process.
pub(super) async fn keep(session: Arc<Session>, clock: Option<Clock>) {
    let lease = clock.as_ref().and_then(Clock::lease);
    let mut ticks = tokio::time::interval(session.pulse_every());
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    while session.state() != State::Down {
        ticks.tick().await;
        if let (Some(lease), Some(clock)) = (lease, &clock) {
            lease.extend(clock.now());
        }
        session.keep();
    }
    // Without the boot there is nobody to give this process up; its tasks are stopped in their order.
    if let Some(lease) = lease {
        lease.lift();
    }
}

/// Tells a session when the process at its other end is gone.
#[allow(
    deprecated,
    reason = "the file belongs to the watcher alone, which is what the function's replacement asks to be promised in unsafe code"
)]
pub(super) async fn watch(session: Arc<Session>, pid: u32) {
    let pid = i32::try_from(pid).ok().and_then(Pid::from_raw);
    let opened = pid.map(|pid| pidfd_open(pid, PidfdFlags::NONBLOCK));
    let ended = match opened {
        Some(Ok(process)) => AsyncFd::with_interest(process, Interest::READABLE),
        Some(Err(rustix::io::Errno::SRCH)) => {
            return session.event(Event::PeerEnded, DownReason::Ended);
        }
        // Then its silence tells.
        _ => return,
    };
    let Ok(process) = ended else {
        return;
    };
    let mut state = session.watch();
    tokio::select! {
        _ = process.readable() => session.event(Event::PeerEnded, DownReason::Ended),
        _ = state.wait_for(|state| *state == State::Down) => {}
    }
}

/// Takes what one session brings.
pub(super) struct PeerReceiver {
    pub(super) mesh: Weak<Inner>,
    pub(super) chassis: ChassisNumber,
    pub(super) incarnation: u32,
}

impl Receiver for PeerReceiver {
    fn up(&self, session: Arc<Session>) {
        let Some(mesh) = self.mesh.upgrade() else {
            return;
        };
        mesh.enlist(self.chassis, self.incarnation, &session);
        mesh.send(MeshEvent::Up {
            chassis: self.chassis,
            incarnation: self.incarnation,
        });
        // The session shows that it is up only when this has returned.
        let runtime = mesh.runtime.clone();
        runtime.spawn(async move { mesh.changed() });
    }

    fn frame(&self, frame: Frame, now: Instant) {
        if let Some(mesh) = self.mesh.upgrade() {
            mesh.chassis.receive(self.chassis, frame, now);
        }
    }

    fn notice(&self, bytes: Vec<u8>) {
        let Some(mesh) = self.mesh.upgrade() else {
            return;
        };
        match postcard::from_bytes(&bytes) {
            Ok(notice) => mesh.heard(self.chassis, notice),
            Err(error) => {
                let peer = mesh.chassis.name_of(self.chassis);
                tracing::error!(peer, error = %error, "a message of the mesh cannot be read");
            }
        }
    }

    fn down(&self, reason: &DownReason) {
        let Some(mesh) = self.mesh.upgrade() else {
            return;
        };
        let peer = mesh.chassis.name_of(self.chassis);
        match reason {
            DownReason::Bye | DownReason::Closed => {
                tracing::debug!(peer, reason = %reason, "link down");
            }
            // Those that end in their order are no news.
            _ if mesh.chassis.is_stopping() => tracing::debug!(peer, reason = %reason, "link down"),
            _ => tracing::warn!(peer, reason = %reason, "link down"),
        }
        if self.chassis == 0 && *reason == DownReason::GivenUp {
            // Nothing that goes on here is true any more for the others.
            if let Some(lease) = mesh.chassis.clock.lease() {
                lease.revoke();
            }
            // Before the tasks see that the boot is gone, and take that for the reason.
            mesh.chassis.exit(EXIT_GIVEN_UP);
        }
        let unlinked = {
            let mut live = lock(&mesh.live);
            // The link of a successor must not go down with this one.
            let is_live = live.get(&self.chassis) == Some(&self.incarnation);
            is_live.then(|| live.remove(&self.chassis));
            is_live.then(|| mesh.chassis.unlink(self.chassis)).flatten()
        };
        if let Some(unlinked) = unlinked {
            mesh.chassis.tell_unlinked(unlinked);
        }
        mesh.send(MeshEvent::Down {
            chassis: self.chassis,
            incarnation: self.incarnation,
            reason: reason.clone(),
        });
        let runtime = mesh.runtime.clone();
        runtime.spawn(async move { mesh.changed() });
    }
}
