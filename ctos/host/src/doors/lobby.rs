//! Where callers stay until they have shown who they are. There is always room for one more: the one who
//! has been silent longest goes for it, so that idle strangers keep no member out.

use std::{
    collections::BTreeMap,
    io,
    sync::{Arc, Mutex},
    time::Duration,
};

use tokio::sync::oneshot;

use super::ACCEPT_PAUSE;
use ctos_time::lock::lock;

/// How long the next caller waits after one was turned out. It bounds how fast strangers can turn out
/// others. A member has at least as many of these pauses as there are places to show who it is.
const PAUSE: Duration = Duration::from_millis(2);

/// Why a caller was not heard to its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(crate) enum Turned {
    #[error("it did not show who it is in time")]
    Late,
    #[error("others came, and it had not shown who it is")]
    Crowded,
}

/// The places of a port for callers who have not shown who they are.
pub(crate) struct Lobby {
    most: usize,
    guests: Mutex<Guests>,
}

#[derive(Default)]
struct Guests {
    /// Counts all that happens: who came, or was served, later has the greater number.
    last: u64,
    seats: BTreeMap<u64, Taken>,
}

/// A seat that is taken.
struct Taken {
    /// Since when its guest has said nothing; `None` while it is served, and not turned out.
    silent: Option<u64>,
    /// Dropped with the seat, which the guest hears.
    _turned: oneshot::Sender<()>,
}

impl Lobby {
    pub(crate) fn new(most: usize) -> Arc<Self> {
        Arc::new(Self {
            most,
            guests: Mutex::default(),
        })
    }

    /// Lets one more in, for whom the longest silent one goes; `None` when all are being served.
    async fn enter(self: &Arc<Self>) -> Option<Guest> {
        if lock(&self.guests).seats.len() >= self.most {
            let turned = self.turn_out();
            tokio::time::sleep(PAUSE).await;
            if !turned {
                return None;
            }
        }
        let (sender, turned) = oneshot::channel();
        let mut guests = lock(&self.guests);
        let number = guests.next();
        let taken = Taken {
            silent: Some(number),
            _turned: sender,
        };
        guests.seats.insert(number, taken);
        let seat = Arc::new(Seat {
            lobby: self.clone(),
            number,
        });
        Some(Guest { seat, turned })
    }

    /// The next caller that there is a place for, and its place. `refuse` hears of each that is lost, and
    /// that came when all were being served.
    pub(crate) async fn next<C, F: Future<Output = io::Result<C>>>(
        self: &Arc<Self>,
        accept: impl Fn() -> F,
        refuse: impl Fn(Option<&C>, &str),
    ) -> (C, Guest) {
        loop {
            match accept().await {
                Ok(caller) => match self.enter().await {
                    Some(guest) => return (caller, guest),
                    None => refuse(Some(&caller), "all connections are busy"),
                },
                // Too many files are open, perhaps: one that does nothing makes room.
                Err(error) => {
                    refuse(None, &format!("it was lost: {error}"));
                    self.turn_out();
                    tokio::time::sleep(ACCEPT_PAUSE).await;
                }
            }
        }
    }

    /// Turns out the longest silent one, if there is one.
    fn turn_out(&self) -> bool {
        let mut guests = lock(&self.guests);
        let silent = guests.seats.iter();
        let silent = silent.filter_map(|(number, taken)| Some((taken.silent?, *number)));
        let longest = silent.min().map(|(_, number)| number);
        longest.is_some_and(|number| guests.seats.remove(&number).is_some())
    }
}

impl Guests {
    fn next(&mut self) -> u64 {
        self.last += 1;
        self.last
    }
}

/// A caller in a lobby.
pub(crate) struct Guest {
    seat: Arc<Seat>,
    turned: oneshot::Receiver<()>,
}

/// Its place there; free when this is dropped.
pub(crate) struct Seat {
    lobby: Arc<Lobby>,
    number: u64,
}

impl Guest {
    /// Its place, to be marked while it is served.
    pub(crate) fn seat(&self) -> Arc<Seat> {
        self.seat.clone()
    }

    /// Does `what` with the caller, unless it is turned out or `timeout` has passed.
    ///
    /// # Errors
    /// Those of `what`, and [`Turned`].
    pub(crate) async fn hear<T, E: From<Turned>>(
        self,
        timeout: Duration,
        what: impl Future<Output = Result<T, E>>,
    ) -> Result<T, E> {
        let heard = tokio::time::timeout(timeout, self.stay(what)).await;
        heard.unwrap_or(Err(Turned::Late))?
    }

    /// As [`Self::hear`], without a timeout.
    ///
    /// # Errors
    /// [`Turned::Crowded`].
    pub(crate) async fn stay<T>(self, what: impl Future<Output = T>) -> Result<T, Turned> {
        let Self {
            seat: _seat,
            turned,
        } = self;
        tokio::select! {
            done = what => Ok(done),
            _ = turned => Err(Turned::Crowded),
        }
    }
}

/// A caller that is being served, and so not turned out.
pub(crate) struct Served(Arc<Seat>);

impl Seat {
    /// Not turned out until what is returned is dropped; `None` when it has been.
    pub(crate) fn serve(self: &Arc<Self>) -> Option<Served> {
        let mut guests = lock(&self.lobby.guests);
        guests.seats.get_mut(&self.number)?.silent = None;
        Some(Served(self.clone()))
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let mut guests = lock(&self.0.lobby.guests);
        let now = guests.next();
        if let Some(taken) = guests.seats.get_mut(&self.0.number) {
            taken.silent = Some(now);
        }
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        lock(&self.lobby.guests).seats.remove(&self.number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run<T>(test: impl Future<Output = T>) -> T {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_time()
            .build();
        runtime.unwrap().block_on(test)
    }

    const FOREVER: Duration = Duration::from_secs(3600);

    #[test]
    fn the_longest_silent_goes_for_the_next_and_places_of_those_that_went_are_free() {
        run(async {
            let lobby = Lobby::new(2);
            let first = lobby.enter().await.unwrap();
            let second = lobby.enter().await.unwrap();
            let third = lobby.enter().await.unwrap();
            let heard = Ok::<u8, Turned>;
            let silent = std::future::pending::<()>;
            assert_eq!(first.stay(silent()).await, Err(Turned::Crowded));
            drop(second);
            let fourth = lobby.enter().await.unwrap();
            assert_eq!(third.hear(FOREVER, async { Ok(3) }).await, heard(3));
            assert_eq!(fourth.hear(FOREVER, async { Ok(4) }).await, heard(4));
        });
    }

    #[test]
    fn who_is_served_is_not_turned_out_and_afterwards_has_been_silent_for_the_shortest_time() {
        run(async {
            let lobby = Lobby::new(2);
            let busy = lobby.enter().await.unwrap();
            let served = busy.seat().serve().unwrap();
            let idle = lobby.enter().await.unwrap();
            let next = lobby.enter().await.unwrap();
            let silent = std::future::pending::<()>;
            assert_eq!(idle.stay(silent()).await, Err(Turned::Crowded));
            let also = next.seat().serve().unwrap();
            assert!(lobby.enter().await.is_none());
            drop(also);
            drop(served);
            let _last = lobby.enter().await.unwrap();
            assert_eq!(next.stay(silent()).await, Err(Turned::Crowded));
            assert_eq!(busy.stay(async { 1 }).await, Ok(1));
        });
    }

    #[test]
    fn who_says_nothing_is_heard_no_longer_than_the_timeout() {
        run(async {
            let guest = Lobby::new(1).enter().await.unwrap();
            let silent = std::future::pending::<Result<(), Turned>>();
            let heard = guest.hear(Duration::from_millis(1), silent).await;
            assert_eq!(heard, Err(Turned::Late));
        });
    }
}
