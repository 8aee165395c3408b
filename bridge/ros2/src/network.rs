//! The session with the network, on a thread of its own: zenoh waits on whatever thread calls it. The task sends [`Order`]s
//! and hears [`Event`]s; neither waits for the other. Knows no message but by its bytes.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{
        Arc, Mutex, PoisonError,
        mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel},
    },
    time::Duration,
};

use bridge_zenoh::Joining;
use ctos::time::Clock;
use tokio::sync::mpsc;
use zenoh::{
    Session, Wait,
    key_expr::KeyExpr,
    liveliness::LivelinessToken,
    pubsub::{Publisher, Subscriber},
    qos::CongestionControl,
    query::{Query, Queryable},
    sample::{Sample, SampleKind},
};

use crate::{
    endpoint::{Attachment, Endpoint, Kind, Node},
    graph::{Graph, Own},
    messages::RosType,
};

/// Messages that may wait to be sent; more are lost.
const ORDERS: usize = 256;
/// What may wait to be heard; more is lost.
pub(crate) const EVENTS: usize = 256;
/// How often it is looked whether the network is there, and how long an attempt to join it may take.
const LOOK: Duration = Duration::from_secs(1);

/// How to join the network.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    pub node: Node,
    pub endpoints: Vec<String>,
    /// Whether nodes connect there, and it is their router; otherwise it connects to one.
    pub is_router: bool,
    /// Certificate, its private half and the authority's certificate, as paths.
    pub keys: Option<[String; 3]>,
    /// Topics that are taken.
    pub take: Vec<(String, RosType)>,
    /// Services.
    pub serve: Vec<(String, RosType)>,
    pub clock: Clock,
}

/// What the network is asked.
pub(crate) enum Order {
    /// Publishes a message, as it is at a moment (ns since 1970).
    Publish {
        name: String,
        of: RosType,
        at_ns: u64,
        bytes: Vec<u8>,
    },
    /// Answers a call.
    Reply {
        call: Call,
        at_ns: u64,
        bytes: Vec<u8>,
    },
}

/// A call of a service, which ends unanswered when it is dropped.
#[derive(Debug)]
pub(crate) struct Call {
    query: Query,
    attachment: Attachment,
}

/// What the network tells.
#[derive(Debug)]
pub(crate) enum Event {
    /// It is there, or is not; with why, where that is known.
    There(bool, String),
    /// How many other nodes there are, and how many endpoints of others fit ours.
    Nodes(usize, Vec<(Own, usize)>),
    /// A message of a topic that is taken.
    Came { name: String, bytes: Vec<u8> },
    /// A call of a service.
    Called {
        name: String,
        bytes: Vec<u8>,
        call: Call,
    },
    /// Something about a topic or a service is not as it must be.
    Wrong { name: String, text: String },
}

/// The task's end.
pub(crate) struct Network {
    orders: SyncSender<Order>,
}

impl Network {
    /// Joins the network as soon as it is there, and whenever it comes back.
    ///
    /// # Errors
    /// There is no thread for it.
    pub fn join(plan: Plan, events: mpsc::Sender<Event>) -> std::io::Result<Self> {
        let (orders, asked) = sync_channel(ORDERS);
        std::thread::Builder::new()
            .name("ros2".to_owned())
            .spawn(move || run(&plan, &asked, &events))?;
        Ok(Self { orders })
    }

    /// Whether there was a place for the order; without one it is lost.
    pub fn order(&self, order: Order) -> bool {
        match self.orders.try_send(order) {
            Ok(()) => true,
            Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => false,
        }
    }
}

/// Tells the task, if there is a place.
fn tell(events: &mpsc::Sender<Event>, event: Event) {
    if events.try_send(event).is_err() {
        tracing::debug!("the task does not keep up with what comes from ROS, or has ended");
    }
}

/// Until the task has ended.
fn run(plan: &Plan, orders: &Receiver<Order>, events: &mpsc::Sender<Event>) {
    let mut told = String::new();
    loop {
        let session = match open(plan) {
            Ok(session) => session,
            Err(error) => {
                let text = error.to_string();
                if told != text {
                    tell(events, Event::There(false, text.clone()));
                    told = text;
                }
                // What is to be published meanwhile is for nobody.
                match orders.recv_timeout(LOOK) {
                    Err(RecvTimeoutError::Disconnected) => return,
                    Ok(_) | Err(RecvTimeoutError::Timeout) => {}
                }
                while orders.try_recv().is_ok() {}
                continue;
            }
        };
        let joined = Joined::new(plan, session, events);
        let ended = joined.and_then(|joined| joined.serve(plan, orders, events));
        match ended {
            Ok(()) => return,
            Err(error) => tell(events, Event::There(false, error.to_string())),
        }
        if let Err(RecvTimeoutError::Disconnected) = orders.recv_timeout(LOOK) {
            return;
        }
    }
}

/// Nodes connect to it as to their router, or it joins theirs.
fn open(plan: &Plan) -> Result<Session, zenoh::Error> {
    let (connect, listen) = match plan.is_router {
        true => (&[][..], &plan.endpoints[..]),
        false => (&plan.endpoints[..], &[][..]),
    };
    let joining = Joining {
        connect,
        listen,
        keys: plan.keys.as_ref(),
        patience: LOOK,
        stamps: true,
        lease: None,
    };
    joining.join()
}

/// A publisher of ours.
struct Published {
    publisher: Publisher<'static>,
    gid: [u8; 16],
    sequence: i64,
    _token: LivelinessToken,
}

/// A session and all that is declared in it.
struct Joined {
    session: Session,
    graph: Arc<Mutex<Graph>>,
    published: BTreeMap<String, Published>,
    /// Names that cannot be published.
    refused: BTreeSet<String>,
    own: Vec<Own>,
    last: (Option<bool>, usize, Vec<(Own, usize)>),
    _node: LivelinessToken,
    _tokens: Vec<LivelinessToken>,
    _subscribers: Vec<Subscriber<()>>,
    _services: Vec<Queryable<()>>,
}

impl Joined {
    fn new(
        plan: &Plan,
        session: Session,
        events: &mpsc::Sender<Event>,
    ) -> Result<Self, zenoh::Error> {
        let zid = session.zid();
        let graph = Arc::new(Mutex::new(Graph::default()));
        let node = session
            .liveliness()
            .declare_token(plan.node.token(zid)?)
            .wait()?;
        let mut joined = Self {
            session: session.clone(),
            graph: graph.clone(),
            published: BTreeMap::new(),
            refused: BTreeSet::new(),
            own: Vec::new(),
            last: (None, 0, Vec::new()),
            _node: node,
            _tokens: Vec::new(),
            _subscribers: Vec::new(),
            _services: Vec::new(),
        };
        for (name, of) in &plan.take {
            let endpoint = joined.endpoint(plan, Kind::Subscription, name, *of)?;
            let (key, name, events) = (endpoint.key.clone(), name.clone(), events.clone());
            let subscriber = session
                .declare_subscriber(endpoint.any_type()?)
                .callback(move |sample: Sample| tell(&events, came(&name, &key, &sample)))
                .wait()?;
            joined._subscribers.push(subscriber);
        }
        for (name, of) in &plan.serve {
            let endpoint = joined.endpoint(plan, Kind::Service, name, *of)?;
            let (name, events) = (name.clone(), events.clone());
            let queryable = session
                .declare_queryable(endpoint.key)
                // Clients of rmw_zenoh reach no others.
                .complete(true)
                .callback(move |query: Query| tell(&events, called(&name, query)))
                .wait()?;
            joined._services.push(queryable);
        }
        let (events, own) = (events.clone(), zid.to_string());
        let watch = session
            .liveliness()
            .declare_subscriber(plan.node.all_tokens())
            .history(true)
            .callback(move |change: Sample| {
                let alive = change.kind() == SampleKind::Put;
                let mut graph = graph.lock().unwrap_or_else(PoisonError::into_inner);
                let change = graph.take(&own, change.key_expr().as_str(), alive);
                if let Some((Own { name, .. }, text)) = change.misfit {
                    tell(&events, Event::Wrong { name, text });
                }
            })
            .wait()?;
        joined._subscribers.push(watch);
        Ok(joined)
    }

    /// Declares that there is an endpoint: its token stands as long as the session.
    fn endpoint(
        &mut self,
        plan: &Plan,
        kind: Kind,
        name: &str,
        of: RosType,
    ) -> Result<Endpoint, zenoh::Error> {
        let (endpoint, token) = self.declare(plan, kind, name, of)?;
        self._tokens.push(token);
        Ok(endpoint)
    }

    fn declare(
        &mut self,
        plan: &Plan,
        kind: Kind,
        name: &str,
        of: RosType,
    ) -> Result<(Endpoint, LivelinessToken), zenoh::Error> {
        let own = Own {
            name: name.to_owned(),
            is_service: kind.is_service(),
        };
        // The node has number 0.
        let number = self.own.len() + 1;
        let endpoint = Endpoint::new((&plan.node, self.session.zid(), number), kind, name, of)?;
        self.graph().add(own.clone(), of);
        self.own.push(own);
        let token = self
            .session
            .liveliness()
            .declare_token(&endpoint.token)
            .wait()?;
        Ok((endpoint, token))
    }

    fn graph(&self) -> std::sync::MutexGuard<'_, Graph> {
        self.graph.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Does what is ordered until the task has ended.
    ///
    /// # Errors
    /// The session is over.
    fn serve(
        mut self,
        plan: &Plan,
        orders: &Receiver<Order>,
        events: &mpsc::Sender<Event>,
    ) -> Result<(), zenoh::Error> {
        let mut next = plan.clock.now();
        loop {
            if plan.clock.now() >= next {
                next = plan.clock.now() + LOOK;
                self.look(plan, events)?;
            }
            match orders.recv_timeout(LOOK) {
                Ok(Order::Publish {
                    name,
                    of,
                    at_ns,
                    bytes,
                }) => {
                    if let Err(error) = self.publish(plan, &name, of, at_ns, bytes) {
                        let text = format!("it cannot be published: {error}");
                        if self.refused.insert(name.clone()) {
                            tell(events, Event::Wrong { name, text });
                        }
                    }
                }
                Ok(Order::Reply { call, at_ns, bytes }) => {
                    let key = call.query.key_expr().clone();
                    let attachment = Attachment {
                        at_ns: i64::try_from(at_ns).unwrap_or(i64::MAX),
                        ..call.attachment
                    };
                    let reply = call
                        .query
                        .reply(key, bytes)
                        .attachment(&attachment.bytes()[..]);
                    if let Err(error) = reply.wait() {
                        tracing::debug!(%error, "who called is gone");
                    }
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return self.session.close().wait(),
            }
        }
    }

    /// Tells what has changed about the network.
    fn look(&mut self, plan: &Plan, events: &mpsc::Sender<Event>) -> Result<(), zenoh::Error> {
        if self.session.is_closed() {
            return Err("the session with the network is over".into());
        }
        let (nodes, peers) = {
            let graph = self.graph();
            let peers = self.own.iter().map(|own| (own.clone(), graph.peers(own)));
            (graph.nodes(), peers.collect::<Vec<_>>())
        };
        // A router is there for whoever comes.
        let there = plan.is_router || self.session.info().routers_zid().wait().next().is_some();
        if self.last.0 != Some(there) {
            let text = match there {
                true => String::new(),
                false => format!("no router answers at {}", plan.endpoints.join(", ")),
            };
            tell(events, Event::There(there, text));
        }
        if (self.last.1, &self.last.2) != (nodes, &peers) {
            tell(events, Event::Nodes(nodes, peers.clone()));
        }
        self.last = (Some(there), nodes, peers);
        Ok(())
    }

    fn publish(
        &mut self,
        plan: &Plan,
        name: &str,
        of: RosType,
        at_ns: u64,
        bytes: Vec<u8>,
    ) -> Result<(), zenoh::Error> {
        if !self.published.contains_key(name) {
            if self.refused.contains(name) {
                return Ok(());
            }
            let (endpoint, token) = self.declare(plan, Kind::Publisher, name, of)?;
            let publisher = self
                .session
                .declare_publisher(endpoint.key)
                .congestion_control(CongestionControl::Drop)
                .wait()?;
            let published = Published {
                publisher,
                gid: endpoint.gid,
                sequence: 0,
                _token: token,
            };
            self.published.insert(name.to_owned(), published);
        }
        let Some(published) = self.published.get_mut(name) else {
            return Ok(());
        };
        published.sequence += 1;
        let attachment = Attachment {
            sequence: published.sequence,
            at_ns: i64::try_from(at_ns).unwrap_or(i64::MAX),
            gid: published.gid,
        };
        let put = published.publisher.put(bytes);
        put.attachment(&attachment.bytes()[..]).wait()
    }
}

/// A sample at a key of the topic `name`, whose own key is `key`.
fn came(name: &str, key: &KeyExpr, sample: &Sample) -> Event {
    let wrong = |text: String| Event::Wrong {
        name: name.to_owned(),
        text,
    };
    if sample.key_expr() != key {
        let at = sample.key_expr();
        return wrong(format!(
            "a message came as `{at}`, of another type than `{key}`: it is not taken"
        ));
    }
    let attached = sample.attachment().map(|bytes| bytes.to_bytes());
    if attached.as_deref().and_then(Attachment::read).is_none() {
        return wrong("a message came without what rmw_zenoh attaches: it is not taken".to_owned());
    }
    Event::Came {
        name: name.to_owned(),
        bytes: sample.payload().to_bytes().into_owned(),
    }
}

fn called(name: &str, query: Query) -> Event {
    let attached = query.attachment().map(|bytes| bytes.to_bytes());
    let Some(attachment) = attached.as_deref().and_then(Attachment::read) else {
        return Event::Wrong {
            name: name.to_owned(),
            text: "a call came without what rmw_zenoh attaches: it is not answered".to_owned(),
        };
    };
    let payload = query
        .payload()
        .map(|payload| payload.to_bytes().into_owned());
    Event::Called {
        name: name.to_owned(),
        bytes: payload.unwrap_or_default(),
        call: Call { query, attachment },
    }
}
