//! The gate's session with the network, on a thread of its own: zenoh waits on whatever thread calls it. The gate sends
//! [`Order`]s and hears [`Event`]s; neither waits for the other. Knows no task.

use std::{
    collections::BTreeSet,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel},
    },
    time::Duration,
};

use bridge_zenoh::Joining;
use ctos::{
    call::Fault,
    time::{Clock, Instant},
};
use serde::de::DeserializeOwned;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use zenoh::{
    Session, Wait,
    bytes::ZBytes,
    pubsub::{Publisher, Subscriber},
    qos::{CongestionControl, Priority},
    query::{Query, QueryTarget, Queryable, Reply},
    sample::Sample,
};

use crate::{
    proof::{Prover, Said},
    signature::Signature,
    wire::{Asked, Beat, Ended, Head, VERSION, all_asks, beat_key, read, written},
};

/// What may wait to be sent.
const ORDERS: usize = 1024;
/// Requests of other sites that may be under way here.
const MOST_SERVED: usize = 1024;
/// How often a gate tells that it is there.
pub(crate) const BEAT: Duration = Duration::from_millis(500);
/// How long an attempt to reach a router may take, and the pause after it.
const RETRY: Duration = Duration::from_secs(1);
/// A router that is silent for so long is given up, and looked for again.
const LEASE: Duration = Duration::from_secs(4);
/// zenoh forgets a request so long after its caller did.
const GRACE: Duration = Duration::from_secs(1);

/// How to join the network.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    /// This site.
    pub site: String,
    /// Which run of its gate this is.
    pub run: u64,
    /// The sites that are listened for.
    pub others: BTreeSet<String>,
    pub connect: Vec<String>,
    /// Where others connect: it is a router then.
    pub listen: Vec<String>,
    /// Certificate, its private half and the authority's certificate, as paths.
    pub keys: Option<[String; 3]>,
    pub prover: Arc<Prover>,
    pub clock: Clock,
}

/// What the network is asked.
pub(crate) enum Order {
    /// Asks a gate something.
    Ask {
        site: String,
        key: String,
        head: Head,
        bytes: Vec<u8>,
    },
    /// Answers a gate.
    Answer {
        to: Incoming,
        answer: Result<Vec<u8>, Fault>,
    },
}

/// A request of another site, which ends unanswered when it is dropped.
#[derive(Debug)]
pub(crate) struct Incoming {
    query: Query,
    /// How it was signed.
    signed: Option<Signature>,
    _place: OwnedSemaphorePermit,
}

/// What the network tells.
#[derive(Debug)]
pub(crate) enum Event {
    /// A router is there, or is not; with why, where that is known.
    There(bool, String),
    /// A gate told that it is there.
    Heard(String, Beat, Instant),
    /// What seemed to be said by a site is not believed.
    Doubted(String, String),
    /// Another site asks.
    Asked {
        asked: Asked,
        head: Head,
        bytes: Vec<u8>,
        to: Box<Incoming>,
    },
    /// A request has its end; `None` when no gate has answered.
    Answered(u64, Option<Result<Vec<u8>, Fault>>),
}

/// The gate's end.
pub(crate) struct Network {
    orders: SyncSender<Order>,
}

impl Network {
    /// Joins the network as soon as it is there, and whenever it comes back.
    ///
    /// # Errors
    /// There is no thread for it.
    pub fn join(plan: Plan, events: mpsc::UnboundedSender<Event>) -> std::io::Result<Self> {
        let (orders, asked) = sync_channel(ORDERS);
        std::thread::Builder::new()
            .name("site".to_owned())
            .spawn(move || run(&plan, &asked, &events))?;
        Ok(Self { orders })
    }

    /// Hands over an order.
    ///
    /// # Errors
    /// Too much waits already: the network does not keep up.
    pub fn order(&self, order: Order) -> Result<(), Fault> {
        let full = |_| Fault::Full { capacity: ORDERS };
        self.orders.try_send(order).map_err(full)
    }
}

/// Tells the gate, unless it has ended.
fn tell(events: &mpsc::UnboundedSender<Event>, event: Event) {
    if events.send(event).is_err() {
        tracing::debug!("the gate has ended");
    }
}

/// Until the gate has ended.
fn run(plan: &Plan, orders: &Receiver<Order>, events: &mpsc::UnboundedSender<Event>) {
    let mut told = String::new();
    loop {
        let why = match open(plan) {
            Ok(session) => {
                told.clear();
                let joined = Joined::new(plan, session, events);
                match joined.and_then(|joined| joined.serve(plan, orders, events)) {
                    Ok(()) => return,
                    Err(error) => error.to_string(),
                }
            }
            Err(error) => error.to_string(),
        };
        if told != why {
            tell(events, Event::There(false, why.clone()));
            told = why;
        }
        // What was asked meanwhile ends when its site counts as cut off.
        let until = plan.clock.now() + RETRY;
        loop {
            match orders.recv_timeout(until.since(plan.clock.now())) {
                Ok(_) => {}
                Err(RecvTimeoutError::Timeout) => break,
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    }
}

fn open(plan: &Plan) -> Result<Session, zenoh::Error> {
    let joining = Joining {
        connect: &plan.connect,
        listen: &plan.listen,
        keys: plan.keys.as_ref(),
        patience: RETRY,
        stamps: false,
        lease: Some(LEASE),
    };
    joining.join()
}

/// A session and all that is declared in it.
struct Joined {
    session: Session,
    beat: Publisher<'static>,
    there: Option<bool>,
    _subscribers: Vec<Subscriber<()>>,
    _asks: Queryable<()>,
}

impl Joined {
    fn new(
        plan: &Plan,
        session: Session,
        events: &mpsc::UnboundedSender<Event>,
    ) -> Result<Self, zenoh::Error> {
        let beat = session
            .declare_publisher(beat_key(&plan.site))
            .congestion_control(CongestionControl::Drop)
            .priority(Priority::InteractiveHigh)
            .express(true)
            .wait()?;
        let mut subscribers = Vec::new();
        for site in &plan.others {
            let (name, events, clock) = (site.clone(), events.clone(), plan.clock.clone());
            let prover = plan.prover.clone();
            let subscriber = session
                .declare_subscriber(beat_key(site))
                .callback(move |sample: Sample| match heard(&sample, &name, &prover) {
                    Ok(beat) => tell(&events, Event::Heard(name.clone(), beat, clock.now())),
                    Err(why) => tell(&events, Event::Doubted(name.clone(), why)),
                })
                .wait()?;
            subscribers.push(subscriber);
        }
        let (places, events) = (Arc::new(Semaphore::new(MOST_SERVED)), events.clone());
        let (site, prover) = (plan.site.clone(), plan.prover.clone());
        let asks = session
            .declare_queryable(all_asks(&plan.site, plan.run))
            .callback(move |query: Query| {
                let Err((from, signed, fault)) =
                    asked(&query, &site, &prover, &places).map(|event| tell(&events, event))
                else {
                    return;
                };
                if let Fault::Refused { text } = &fault {
                    tell(&events, Event::Doubted(from, text.clone()));
                }
                answer(&prover, &query, signed.as_ref(), Err(fault));
            })
            .wait()?;
        Ok(Self {
            session,
            beat,
            there: None,
            _subscribers: subscribers,
            _asks: asks,
        })
    }

    /// Does what is ordered until the gate has ended.
    ///
    /// # Errors
    /// The session is over.
    fn serve(
        mut self,
        plan: &Plan,
        orders: &Receiver<Order>,
        events: &mpsc::UnboundedSender<Event>,
    ) -> Result<(), zenoh::Error> {
        let mut next = plan.clock.now();
        loop {
            let now = plan.clock.now();
            if now >= next {
                next = now + BEAT;
                self.look(plan, events)?;
                let beat = Beat {
                    version: VERSION,
                    run: plan.run,
                };
                let signed = plan.prover.sign(Said::Beat(self.beat.key_expr(), beat));
                let put = self.beat.put(written(&beat));
                put.attachment(written(&signed)).wait()?;
            }
            match orders.recv_timeout(next.since(plan.clock.now())) {
                Ok(Order::Ask {
                    site,
                    key,
                    head,
                    bytes,
                }) => {
                    let signed = plan.prover.sign(Said::Ask(&key, head, &bytes));
                    let awaited = Awaited {
                        site,
                        key: key.clone(),
                        number: head.number,
                        signed: signed.clone(),
                        prover: plan.prover.clone(),
                        events: events.clone(),
                        answered: AtomicBool::new(false),
                    };
                    self.session
                        .get(key)
                        .payload(bytes)
                        .attachment(written(&(head, signed)))
                        .target(QueryTarget::BestMatching)
                        .timeout(head.left() + GRACE)
                        .callback(move |reply| awaited.take(&reply))
                        .wait()?;
                }
                Ok(Order::Answer { to, answer: with }) => {
                    answer(&plan.prover, &to.query, to.signed.as_ref(), with);
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return self.session.close().wait(),
            }
        }
    }

    /// Tells what has changed about the network.
    fn look(
        &mut self,
        plan: &Plan,
        events: &mpsc::UnboundedSender<Event>,
    ) -> Result<(), zenoh::Error> {
        if self.session.is_closed() {
            return Err("the session with the network is over".into());
        }
        // A router is there for whoever comes.
        let there =
            !plan.listen.is_empty() || self.session.info().routers_zid().wait().next().is_some();
        if self.there != Some(there) {
            let text = match there {
                true => String::new(),
                false => format!("no router answers at {}", plan.connect.join(", ")),
            };
            tell(events, Event::There(there, text));
            self.there = Some(there);
        }
        Ok(())
    }
}

/// Who waits for an answer; it is told that there is none when zenoh gives the request up.
struct Awaited {
    site: String,
    key: String,
    number: u64,
    /// How the request was signed.
    signed: Option<Signature>,
    prover: Arc<Prover>,
    events: mpsc::UnboundedSender<Event>,
    answered: AtomicBool,
}

impl Awaited {
    fn take(&self, reply: &Reply) {
        let Ok(sample) = reply.result() else { return };
        let bytes = sample.payload().to_bytes();
        let answer = match self.believed(sample, &bytes) {
            Ok(Ok(())) => Ok(bytes.into_owned()),
            Ok(Err(fault)) => Err(fault),
            // The site itself may still answer.
            Err(why) => return tell(&self.events, Event::Doubted(self.site.clone(), why)),
        };
        if !self.answered.swap(true, Ordering::Relaxed) {
            tell(&self.events, Event::Answered(self.number, Some(answer)));
        }
    }

    /// How it ended, as the site itself says.
    fn believed(&self, sample: &Sample, bytes: &[u8]) -> Result<Ended, String> {
        let beside: Option<(Ended, Option<Signature>)> = beside(sample.attachment());
        let (ended, signature) = beside.ok_or("its answer cannot be read")?;
        let said = Said::Answer(&self.key, self.signed.as_ref(), &ended, bytes);
        let checked = self.prover.check(&self.site, said, signature.as_ref());
        let wrong = |why| format!("its answer is not believed: {why}");
        checked.map_err(wrong).map(|()| ended)
    }
}

impl Drop for Awaited {
    fn drop(&mut self) {
        if !self.answered.load(Ordering::Relaxed) {
            tell(&self.events, Event::Answered(self.number, None));
        }
    }
}

/// What stands beside the data.
fn beside<T: DeserializeOwned>(attachment: Option<&ZBytes>) -> Option<T> {
    read(&attachment?.to_bytes())
}

/// A sign of life of a site.
fn heard(sample: &Sample, site: &str, prover: &Prover) -> Result<Beat, String> {
    let beat: Beat = read(&sample.payload().to_bytes()).ok_or("its sign of life cannot be read")?;
    let signature: Option<Signature> = beside(sample.attachment()).flatten();
    let said = Said::Beat(sample.key_expr(), beat);
    let checked = prover.check(site, said, signature.as_ref());
    let wrong = |why| {
        let version = beat.version;
        format!("its sign of life, of version {version}, is not believed: {why}")
    };
    checked.map_err(wrong).map(|()| beat)
}

/// What another site asks; or why not, and by whom it seems to be asked.
fn asked(
    query: &Query,
    site: &str,
    prover: &Prover,
    places: &Arc<Semaphore>,
) -> Result<Event, (String, Option<Signature>, Fault)> {
    let unreadable = |text: &str| Fault::BadPayload {
        text: text.to_owned(),
    };
    let key = query.key_expr().as_str();
    let Some(asked) = Asked::of_key(key) else {
        let fault = unreadable("the key names no task and command");
        return Err((String::new(), None, fault));
    };
    let from = asked.from.clone();
    let head: Option<(Head, Option<Signature>)> = beside(query.attachment());
    let Some((head, signature)) = head.filter(|(head, _)| head.version == VERSION) else {
        let fault = unreadable("the gates speak different versions");
        return Err((from, None, fault));
    };
    let payload = query.payload().map(ZBytes::to_bytes).unwrap_or_default();
    let said = Said::Ask(key, head, &payload);
    if let Err(why) = prover.check(&from, said, signature.as_ref()) {
        let text =
            format!("site `{site}` does not take this for a request of site `{from}`: {why}");
        return Err((from, signature, Fault::Refused { text }));
    }
    let Ok(place) = places.clone().try_acquire_owned() else {
        let capacity = MOST_SERVED;
        return Err((from, signature, Fault::Full { capacity }));
    };
    let to = Incoming {
        query: query.clone(),
        signed: signature,
        _place: place,
    };
    let to = Box::new(to);
    let bytes = payload.into_owned();
    Ok(Event::Asked {
        asked,
        head,
        bytes,
        to,
    })
}

fn answer(prover: &Prover, query: &Query, asked: Option<&Signature>, with: Result<Vec<u8>, Fault>) {
    let (ended, bytes): (Ended, _) = match with {
        Ok(bytes) => (Ok(()), bytes),
        Err(fault) => (Err(fault), Vec::new()),
    };
    let signed = prover.sign(Said::Answer(query.key_expr(), asked, &ended, &bytes));
    let reply = query.reply(query.key_expr().clone(), bytes);
    if let Err(error) = reply.attachment(written(&(ended, signed))).wait() {
        tracing::debug!(%error, "who asked is gone");
    }
}

#[cfg(test)]
mod tests {
    use std::{net::TcpListener, path::Path};

    use ctos::security::Role;

    use super::*;
    use crate::proof::tests::with_key;

    const RUN: u64 = 5;

    /// A gate of some site, with somebody's key.
    struct Someone {
        network: Network,
        events: mpsc::UnboundedReceiver<Event>,
        asked: u64,
    }

    impl Someone {
        fn joins(folder: &Path, prover: Prover, key: &str, plan: Plan) -> Self {
            let file = |name: String| folder.join(name).to_string_lossy().into_owned();
            let keys = [
                format!("{key}.pem"),
                format!("{key}.key"),
                "ca.pem".to_owned(),
            ];
            let (events, told) = mpsc::unbounded_channel();
            let plan = Plan {
                keys: Some(keys.map(file)),
                prover: Arc::new(prover),
                ..plan
            };
            Self {
                network: Network::join(plan, events).unwrap(),
                events: told,
                asked: 0,
            }
        }

        /// What it is told, as soon as something is wanted; not if it is told too much else.
        fn told<T>(&mut self, wanted: impl Fn(Event) -> Option<T>) -> T {
            let mut events = (0..100).map(|_| self.events.blocking_recv().unwrap());
            events.find_map(wanted).unwrap()
        }

        /// Asks a run of the gate of north, in the name of south.
        fn asks(&mut self, run: u64) {
            self.asked += 1;
            let asked = Asked {
                from: "south".to_owned(),
                task: "depot".to_owned(),
                command: 1,
            };
            let ask = Order::Ask {
                site: "north".to_owned(),
                key: asked.key("north", run),
                head: Head::new(Duration::from_secs(60), true, 1, self.asked),
                bytes: b"hat".to_vec(),
            };
            self.network.order(ask).unwrap();
        }

        /// Answers what is asked next.
        fn answers(&mut self) {
            let to = self.told(|event| match event {
                Event::Asked { to, .. } => Some(to),
                _ => None,
            });
            let answer = Ok(b"stored".to_vec());
            self.network
                .order(Order::Answer { to: *to, answer })
                .unwrap();
        }

        fn answer(&mut self) -> Option<Result<Vec<u8>, Fault>> {
            let number = self.asked;
            self.told(|event| match event {
                Event::Answered(of, answer) if of == number => Some(answer),
                _ => None,
            })
        }

        fn doubts(&mut self, whom: &str, what: &str) {
            self.told(|event| match event {
                Event::Doubted(site, why) if site == whom && why == what => Some(()),
                _ => None,
            });
        }
    }

    #[test]
    fn who_has_a_key_of_the_authority_can_neither_ask_nor_answer_for_another_site() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let names = ["north", "south", "west", "east"];
        let [north, south, west, east] = names.map(|name| with_key(folder, name, Role::Boot));
        // A port that nobody has at the moment.
        let port = {
            let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
            listener.local_addr().unwrap().port()
        };
        let address = vec![format!("tls/127.0.0.1:{port}")];
        let plan = |site: &str, run, other: &str| Plan {
            site: site.to_owned(),
            run,
            others: BTreeSet::from([other.to_owned()]),
            connect: address.clone(),
            listen: Vec::new(),
            keys: None,
            prover: Arc::new(Prover::without_keys()),
            clock: Clock::real(),
        };
        let router = Plan {
            connect: Vec::new(),
            listen: address.clone(),
            ..plan("north", RUN, "south")
        };
        let mut north = Someone::joins(folder, north, "north", router);
        north.told(|event| matches!(event, Event::There(true, _)).then_some(()));
        let mut south = Someone::joins(folder, south, "south", plan("south", 1, "north"));
        let heard = |event| match event {
            Event::Heard(site, beat, _) => Some((site, beat.run)),
            _ => None,
        };
        assert_eq!(south.told(heard), ("north".to_owned(), RUN));
        assert_eq!(north.told(heard), ("south".to_owned(), 1));

        // The true one is answered.
        south.asks(RUN);
        north.answers();
        assert_eq!(south.answer(), Some(Ok(b"stored".to_vec())));

        // Another one is not, nor is its sign of life taken for one of south.
        let lie = plan("south", 2, "north");
        for (prover, why) in [
            (west, "it is signed by the key of `west`"),
            (Prover::without_keys(), "it is not signed"),
        ] {
            let mut liar = Someone::joins(folder, prover, "west", lie.clone());
            let life = format!("its sign of life, of version {VERSION}, is not believed: {why}");
            north.doubts("south", &life);
            liar.told(heard);
            liar.asks(RUN);
            let text =
                format!("site `north` does not take this for a request of site `south`: {why}");
            assert_eq!(liar.answer(), Some(Err(Fault::Refused { text })));
        }

        // Nor does south believe another one's answers, and no answer is told as none.
        let lie = plan("north", RUN + 1, "south");
        let mut liar = Someone::joins(folder, east, "east", lie);
        let why = "is not believed: it is signed by the key of `east`";
        south.doubts(
            "north",
            &format!("its sign of life, of version {VERSION}, {why}"),
        );
        south.asks(RUN + 1);
        liar.answers();
        assert_eq!(south.answer(), None);
    }
}
