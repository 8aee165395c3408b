//! Trading: several daemons offer a class, and a request goes to the one that suits it best (SORMA technical
//! report, sections 1.4.3 and 3.5).
//!
//! What is traded is written where daemons are named: in the dictionary, `SCALE trade arm=left -least price`
//! in place of `SCALE d1`. A daemon offers a class with attributes, in its configuration or by `sorm CTRL
//! -offer`. The offers that meet the requirements are ranked. Daemons that answer come before those that do
//! not or are slow. Then attributes decide, then which daemon had the object before, then how long the
//! daemon's answers took. Every client measures for itself.

pub(crate) mod market;
pub(crate) mod wanted;

use market::FIRST;
pub use market::Ranked;
pub use wanted::{Attributes, Wanted, attributes};

use crate::comm::Comm;
use crate::name::{Location, ObjectName};
use crate::report::Report;
use crate::request::{Method, Request};
use crate::sorm::Sorm;
use crate::transport::Transport;
use futures_util::future::{Either, join_all, select};
use std::pin::pin;
use std::time::Duration;

/// A daemon is asked for its offers again when the last answer is older than this.
const REFRESH: Duration = Duration::from_secs(1);

impl Sorm {
    /// Offers a class to others, with attributes; an earlier offer of it is replaced.
    pub fn offer(&self, class: &str, attributes: Attributes) {
        self.inner.market.lock().offer(class, attributes);
    }

    /// Offers a class no more. Says whether it was offered.
    pub fn withdraw(&self, class: &str) -> bool {
        self.inner.market.lock().withdraw(class)
    }

    /// What this process offers: a line for each class, `class attribute=value ...`.
    #[must_use]
    pub fn offers(&self) -> Vec<String> {
        market::listed(self.inner.market.lock().own())
    }

    /// What is known about the daemons that were asked for offers: a line for each.
    #[must_use]
    pub fn market(&self) -> Vec<String> {
        self.inner.market.lock().lines(self.now())
    }

    /// The offers for an object, the best first. The process asks daemons that it does not know yet, and
    /// waits for them. It asks the others again at the same time, without waiting.
    ///
    /// # Errors
    /// Nobody offers the class as it is wanted; the report says what is missing.
    pub async fn offers_for(
        &self,
        comm: &dyn Comm,
        name: &ObjectName,
        wanted: &Wanted,
    ) -> Result<Vec<Ranked>, Report> {
        let daemons = match wanted.among() {
            [] => comm.daemons(),
            among => among.to_vec(),
        };
        let (mut unknown, mut known) = (Vec::new(), Vec::new());
        for daemon in &daemons {
            let due = self.inner.market.lock().begin(daemon, self.now(), REFRESH);
            match due {
                Some(true) => known.push(daemon.clone()),
                Some(false) => unknown.push(daemon.clone()),
                None => {}
            }
        }
        for daemon in known {
            self.look_beside(comm, daemon).await;
        }
        if !unknown.is_empty() {
            let asked = unknown.iter().map(|daemon| self.look(comm, daemon));
            let asked = pin!(join_all(asked));
            if let Either::Right(_) = select(asked, comm.sleep(FIRST)).await {
                tracing::warn!(?unknown, "not all daemons have told what they offer");
                let now = self.now();
                self.inner.market.lock().given_up(&unknown, now);
            }
        }
        self.first_answers(comm, &daemons).await;
        let market = self.inner.market.lock();
        let ranked = market.rank(&daemons, name, wanted, self.now());
        if ranked.is_empty() {
            return Err(wanted.unmet(name, &market.said(&daemons, name.class())));
        }
        Ok(ranked)
    }

    /// Waits for the answers of daemons that another request has just asked for the first time.
    async fn first_answers(&self, comm: &dyn Comm, daemons: &[String]) {
        let mut limit = comm.sleep(FIRST);
        let known = self.inner.market.lock().known();
        loop {
            let mut changed = pin!(known.notified());
            // From now on a change is seen, also one before the next wait.
            changed.as_mut().enable();
            if !self.inner.market.lock().asks_first(daemons, self.now()) {
                return;
            }
            if let Either::Right(_) = select(changed, &mut limit).await {
                return;
            }
        }
    }

    /// The daemon whose offer for an object is the best.
    pub(crate) async fn best(
        &self,
        comm: &dyn Comm,
        name: &ObjectName,
        wanted: &Wanted,
    ) -> Result<Location, Report> {
        let offers = self.offers_for(comm, name, wanted).await?;
        let offer = offers.into_iter().next();
        let offer = offer.ok_or_else(|| wanted.unmet(name, &[]))?;
        Ok(Location::Alias(offer.daemon))
    }

    /// Asks a daemon what it offers while the caller goes on.
    async fn look_beside(&self, comm: &dyn Comm, daemon: String) {
        let (sorm, name) = (self.clone(), daemon.clone());
        let begun = comm.spawn(Box::new(move |comm| {
            Box::pin(async move { sorm.look(&*comm, &name).await })
        }));
        if begun.is_err() {
            self.look(comm, &daemon).await;
        }
    }

    /// Asks a daemon what it offers, and how long that takes.
    async fn look(&self, comm: &dyn Comm, daemon: &str) {
        let Ok(name) = "sorm".parse() else { return };
        let request = Request {
            name,
            method: Method::Ctrl,
            body: Transport::text("-offers"),
        };
        let asked = self.now();
        let at = Location::Alias(daemon.to_owned());
        let answer = comm.ask_once(&at, request).await;
        let now = self.now();
        let mut market = self.inner.market.lock();
        match answer {
            Ok(answer) if answer.is_ok() => market.heard(daemon, &answer.text, asked, now),
            Ok(_) => market.heard(daemon, "", asked, now),
            Err(_) => market.down(daemon, now),
        }
    }

    /// Has a request met by the daemon with the best offer. A daemon may give no answer. Then the next one
    /// is asked if the request was certainly not executed, or if the caller permits a second execution.
    pub(crate) async fn ask_traded(
        &self,
        comm: &dyn Comm,
        wanted: &Wanted,
        name: &ObjectName,
        method: Method,
        body: &mut Transport,
    ) {
        let offers = match self.offers_for(comm, name, wanted).await {
            Ok(offers) => offers,
            Err(report) => return self.unanswered(name, body, report),
        };
        let mut left = comm.retries();
        let mut last = None;
        for offer in offers {
            let at = Location::Alias(offer.daemon.clone());
            let request = Request {
                name: name.here(),
                method,
                body: body.clone(),
            };
            self.used(&at, &request.name);
            let _given = Given::to(self, &offer.daemon);
            match comm.ask_once(&at, request).await {
                Ok(answer) => {
                    *body = answer;
                    let moved = self.inner.market.lock().chose(name, &offer.daemon);
                    if let Some(from) = moved {
                        tracing::info!(object = %name, from, to = offer.daemon, "its requests go to another daemon");
                    }
                    return;
                }
                Err(lost) => {
                    self.inner.market.lock().down(&offer.daemon, self.now());
                    if lost.perhaps_executed && left == 0 {
                        return self.unanswered(name, body, lost.report);
                    }
                    left -= u32::from(lost.perhaps_executed);
                    last = Some(lost.report);
                }
            }
        }
        let report = last.unwrap_or_else(|| wanted.unmet(name, &[]));
        self.unanswered(name, body, report);
    }
}

/// A request that a daemon was given; it is over when this is dropped, also when nobody waits for it any more.
struct Given<'a> {
    sorm: &'a Sorm,
    daemon: &'a str,
}

impl<'a> Given<'a> {
    fn to(sorm: &'a Sorm, daemon: &'a str) -> Self {
        sorm.inner.market.lock().gives(daemon);
        Self { sorm, daemon }
    }
}

impl Drop for Given<'_> {
    fn drop(&mut self) {
        self.sorm.inner.market.lock().over(self.daemon);
    }
}
