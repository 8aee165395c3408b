//! The other libraries, each as its documentation suggests: a server that answers 64 bytes with eight,
//! and one that only takes them.

use std::thread::JoinHandle;

use tokio::{
    runtime::Runtime,
    sync::{mpsc, oneshot},
};

/// 64 bytes.
pub type Data = [u64; 8];

/// How many of the idle tasks are asked.
pub const WINDOW: usize = 10_000;

/// Room in bounded queues.
const ROOM: usize = 1024;

/// A caller and who answers it.
pub trait Pair {
    /// Makes so many calls, one after the other.
    fn calls(&mut self, count: u32);
}

pub fn current_thread() -> Runtime {
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .expect("a runtime")
}

/// Pins the calling thread.
pub fn pin(cpu: Option<usize>) {
    if let Some(cpu) = cpu {
        let mut set = rustix::thread::CpuSet::new();
        set.set(cpu);
        rustix::thread::sched_setaffinity(None, &set).expect("a CPU of this machine");
    }
}

/// Where the server of a pair runs: in the caller's runtime, or on a thread of its own.
#[derive(Debug, Clone, Copy)]
pub enum Server {
    Here,
    Thread(Option<usize>),
}

// -- tokio ------------------------------------------------------------------------------------

type Asked = (Data, oneshot::Sender<u64>);

async fn answer_all(mut asked: mpsc::Receiver<Asked>) {
    while let Some((data, reply)) = asked.recv().await {
        let _ = reply.send(data[0]);
    }
}

pub struct Tokio {
    runtime: Runtime,
    ask: mpsc::Sender<Asked>,
}

impl Tokio {
    pub fn new(server: Server) -> Self {
        let runtime = current_thread();
        let (ask, asked) = mpsc::channel(64);
        match server {
            Server::Here => drop(runtime.spawn(answer_all(asked))),
            Server::Thread(cpu) => drop(std::thread::spawn(move || {
                pin(cpu);
                current_thread().block_on(answer_all(asked));
            })),
        }
        Self { runtime, ask }
    }
}

impl Pair for Tokio {
    fn calls(&mut self, count: u32) {
        let ask = self.ask.clone();
        self.runtime.block_on(async {
            let asking = tokio::spawn(async move {
                for _ in 0..count {
                    let (reply, answer) = oneshot::channel();
                    let _ = ask.send((Data::default(), reply)).await;
                    answer.await.expect("an answer");
                }
            });
            asking.await.expect("no panic");
        });
    }
}

// -- ractor -----------------------------------------------------------------------------------

pub enum RactorMessage {
    Ask(Data, ractor::RpcReplyPort<u64>),
    Tell(Data),
}

pub struct RactorActor;

impl ractor::Actor for RactorActor {
    type Msg = RactorMessage;
    type State = ();
    type Arguments = ();

    async fn pre_start(
        &self,
        _: ractor::ActorRef<RactorMessage>,
        (): (),
    ) -> Result<(), ractor::ActorProcessingErr> {
        Ok(())
    }

    async fn handle(
        &self,
        _: ractor::ActorRef<RactorMessage>,
        message: RactorMessage,
        (): &mut (),
    ) -> Result<(), ractor::ActorProcessingErr> {
        match message {
            RactorMessage::Ask(data, reply) => {
                let _ = reply.send(data[0]);
            }
            RactorMessage::Tell(data) => {
                std::hint::black_box(data);
            }
        }
        Ok(())
    }
}

async fn ractor_actor() -> ractor::ActorRef<RactorMessage> {
    let spawned = <RactorActor as ractor::Actor>::spawn(None, RactorActor, ()).await;
    spawned.expect("an actor").0
}

/// Makes an actor on a runtime of its own thread, which it keeps.
fn on_thread<T: Send + 'static>(
    cpu: Option<usize>,
    make: impl AsyncFnOnce() -> T + Send + 'static,
) -> T {
    let (sender, made) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        pin(cpu);
        current_thread().block_on(async {
            let _ = sender.send(make().await);
            std::future::pending::<()>().await;
        });
    });
    made.recv().expect("it is made")
}

pub struct Ractor {
    runtime: Runtime,
    actor: ractor::ActorRef<RactorMessage>,
}

impl Ractor {
    pub fn new(server: Server) -> Self {
        let runtime = current_thread();
        let actor = match server {
            Server::Here => runtime.block_on(ractor_actor()),
            Server::Thread(cpu) => on_thread(cpu, async || ractor_actor().await),
        };
        Self { runtime, actor }
    }
}

impl Pair for Ractor {
    fn calls(&mut self, count: u32) {
        let actor = self.actor.clone();
        self.runtime.block_on(async {
            let asking = tokio::spawn(async move {
                for _ in 0..count {
                    let ask = |reply| RactorMessage::Ask(Data::default(), reply);
                    let answer = actor.call(ask, None).await.expect("it is sent");
                    answer.expect("an answer");
                }
            });
            asking.await.expect("no panic");
        });
    }
}

// -- kameo ------------------------------------------------------------------------------------

#[derive(kameo::Actor)]
pub struct KameoActor;

pub struct KameoAsk(Data);

impl kameo::message::Message<KameoAsk> for KameoActor {
    type Reply = u64;

    async fn handle(
        &mut self,
        KameoAsk(data): KameoAsk,
        _: &mut kameo::message::Context<Self, u64>,
    ) -> u64 {
        data[0]
    }
}

async fn kameo_actor() -> kameo::actor::ActorRef<KameoActor> {
    <KameoActor as kameo::actor::Spawn>::spawn(KameoActor)
}

pub struct Kameo {
    runtime: Runtime,
    actor: kameo::actor::ActorRef<KameoActor>,
}

impl Kameo {
    pub fn new(server: Server) -> Self {
        let runtime = current_thread();
        let actor = match server {
            Server::Here => runtime.block_on(kameo_actor()),
            Server::Thread(cpu) => on_thread(cpu, async || kameo_actor().await),
        };
        Self { runtime, actor }
    }
}

impl Pair for Kameo {
    fn calls(&mut self, count: u32) {
        let actor = self.actor.clone();
        self.runtime.block_on(async {
            let asking = tokio::spawn(async move {
                for _ in 0..count {
                    let asked = actor.ask(KameoAsk(Data::default()));
                    asked.await.expect("an answer");
                }
            });
            asking.await.expect("no panic");
        });
    }
}

// -- bare threads -----------------------------------------------------------------------------

/// kanal with a bounded(1) channel each way.
pub struct Kanal {
    ask: kanal::Sender<Data>,
    answers: kanal::Receiver<u64>,
}

impl Kanal {
    pub fn new(cpu: Option<usize>) -> Self {
        let (ask, asked) = kanal::bounded::<Data>(1);
        let (answer, answers) = kanal::bounded::<u64>(1);
        std::thread::spawn(move || {
            pin(cpu);
            while let Ok(data) = asked.recv() {
                if answer.send(data[0]).is_err() {
                    break;
                }
            }
        });
        Self { ask, answers }
    }
}

impl Pair for Kanal {
    fn calls(&mut self, count: u32) {
        for _ in 0..count {
            self.ask.send(Data::default()).expect("it is sent");
            self.answers.recv().expect("an answer");
        }
    }
}

/// One word that two threads hand to each other, spinning: what no message can beat. The other thread
/// is there while calls are made only: it would keep the others from its core.
pub struct Floor {
    cpu: Option<usize>,
}

impl Floor {
    pub fn new(cpu: Option<usize>) -> Self {
        Self { cpu }
    }
}

impl Pair for Floor {
    fn calls(&mut self, count: u32) {
        use std::sync::{
            Arc,
            atomic::{AtomicU64, Ordering},
        };
        let (word, cpu) = (Arc::new(AtomicU64::new(0)), self.cpu);
        let other = word.clone();
        let server = std::thread::spawn(move || {
            pin(cpu);
            // It begins on the core of its starter, which must not spin before it has left.
            other.store(2, Ordering::Release);
            loop {
                match other.load(Ordering::Acquire) {
                    u64::MAX => return,
                    odd if odd % 2 == 1 => other.store(odd + 1, Ordering::Release),
                    _ => std::hint::spin_loop(),
                }
            }
        });
        while word.load(Ordering::Acquire) == 0 {
            std::thread::yield_now();
        }
        for _ in 0..count {
            let wanted = word.load(Ordering::Acquire) + 2;
            word.store(wanted - 1, Ordering::Release);
            while word.load(Ordering::Acquire) != wanted {
                std::hint::spin_loop();
            }
        }
        word.store(u64::MAX, Ordering::Release);
        server.join().expect("no panic");
    }
}

// -- one way ----------------------------------------------------------------------------------

/// Runs `producers` threads that each call `send` so often, and a consumer of all of it.
fn threads(
    producers: u32,
    count: u32,
    send: impl Fn() + Send + Clone + 'static,
    take: impl FnOnce(u32) + Send + 'static,
) {
    let each = count / producers;
    let consumer = std::thread::spawn(move || take(each * producers));
    let running: Vec<JoinHandle<()>> = (0..producers)
        .map(|_| {
            let send = send.clone();
            std::thread::spawn(move || (0..each).for_each(|_| send()))
        })
        .collect();
    for producer in running {
        producer.join().expect("no panic");
    }
    consumer.join().expect("no panic");
}

pub fn crossbeam_one_way(producers: u32, count: u32) {
    let (tell, told) = crossbeam_channel::bounded(ROOM);
    let send = move || tell.send(Data::default()).expect("it is sent");
    threads(producers, count, send, move |count| {
        for _ in 0..count {
            std::hint::black_box(told.recv().expect("a message"));
        }
    });
}

pub fn kanal_one_way(producers: u32, count: u32) {
    let (tell, told) = kanal::bounded(ROOM);
    let send = move || tell.send(Data::default()).expect("it is sent");
    threads(producers, count, send, move |count| {
        for _ in 0..count {
            std::hint::black_box(told.recv().expect("a message"));
        }
    });
}

pub fn flume_one_way(producers: u32, count: u32) {
    let (tell, told) = flume::bounded(ROOM);
    let send = move || tell.send(Data::default()).expect("it is sent");
    threads(producers, count, send, move |count| {
        for _ in 0..count {
            std::hint::black_box(told.recv().expect("a message"));
        }
    });
}

/// Producers on threads with a runtime each, the consumer on another one.
pub fn tokio_one_way(producers: u32, count: u32) {
    let each = count / producers;
    let (tell, mut told) = mpsc::channel::<Data>(ROOM);
    let consumer = std::thread::spawn(move || {
        current_thread().block_on(async {
            while let Some(data) = told.recv().await {
                std::hint::black_box(data);
            }
        });
    });
    let running: Vec<JoinHandle<()>> = (0..producers)
        .map(|_| {
            let tell = tell.clone();
            std::thread::spawn(move || {
                current_thread().block_on(async {
                    for _ in 0..each {
                        tell.send(Data::default()).await.expect("it is sent");
                    }
                });
            })
        })
        .collect();
    drop(tell);
    for producer in running {
        producer.join().expect("no panic");
    }
    consumer.join().expect("no panic");
}

/// An actor on a thread of its own; producers cast to it from threads.
pub struct RactorOneWay {
    runtime: Runtime,
    actor: ractor::ActorRef<RactorMessage>,
}

impl RactorOneWay {
    pub fn new() -> Self {
        Self {
            runtime: current_thread(),
            actor: on_thread(None, async || ractor_actor().await),
        }
    }

    pub fn send(&mut self, producers: u32, count: u32) {
        let each = count / producers;
        let running: Vec<JoinHandle<()>> = (0..producers)
            .map(|_| {
                let actor = self.actor.clone();
                std::thread::spawn(move || {
                    for _ in 0..each {
                        let tell = RactorMessage::Tell(Data::default());
                        actor.cast(tell).expect("it is sent");
                    }
                })
            })
            .collect();
        for producer in running {
            producer.join().expect("no panic");
        }
        let actor = self.actor.clone();
        self.runtime.block_on(async move {
            let ask = |reply| RactorMessage::Ask(Data::default(), reply);
            let answer = actor.call(ask, None).await.expect("it is sent");
            answer.expect("an answer");
        });
    }
}

// -- idle -------------------------------------------------------------------------------------

/// Tokio tasks that wait at a channel each.
pub struct TokioIdle {
    runtime: Runtime,
    asks: Vec<mpsc::Sender<Asked>>,
}

impl TokioIdle {
    pub fn new() -> Self {
        Self {
            runtime: current_thread(),
            asks: Vec::new(),
        }
    }

    pub fn spawn(&mut self, count: u32) {
        self.runtime.block_on(async {
            for _ in 0..count {
                let (ask, asked) = mpsc::channel(64);
                tokio::spawn(answer_all(asked));
                self.asks.push(ask);
            }
            tokio::task::yield_now().await;
        });
    }

    pub fn ask_all(&mut self) {
        self.runtime.block_on(async {
            for ask in self.asks.iter().take(WINDOW) {
                let (reply, answer) = oneshot::channel();
                let _ = ask.send((Data::default(), reply)).await;
                answer.await.expect("an answer");
            }
        });
    }
}
