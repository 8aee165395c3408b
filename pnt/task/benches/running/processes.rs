//! The time from the moment when a transition is enabled to the start of its action in another process. The action is
//! a command to that process, or an action of a net to which a token goes. Beside it stands the time of one byte
//! through a plain socket between processes in the same place. Nothing else runs meanwhile: each of the two processes
//! waits for the other, and their progress is read only after their end.
//!
//! `cargo bench -p pnt --bench running -- processes` has all of [`PLACEMENTS`]. `--pin` (both on one core), `--pin2`
//! (a core each, asleep until something comes) and `--spin` (a core each, polling) have one of them.

use std::{
    ffi::OsString,
    fmt,
    io::{self, Read, Write},
    net::{TcpListener, TcpStream},
    process::{Command as Process, Stdio},
    sync::{Arc, Mutex},
};

use ctos::{
    boot::{End, Launcher, Observer, boot, run_chassis},
    config::{App, load_texts},
    diagnostic::Source,
    message::{Command as _, Message},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, Phase},
    time::Clock,
};
use pnt_language::compile;
use pnt_task::{
    library::{Action, Library},
    task::{COMMANDS, NetTask, PutTape, Settings},
};

use tokio::sync::Notify;

/// Actions whose start is timed.
const ACTIONS: usize = 20_000;

/// Where the two processes are, and whether they look for messages before they sleep.
struct Placement {
    flag: &'static str,
    name: &'static str,
    cores: [usize; 2],
    spins: bool,
}

const PLACEMENTS: [Placement; 3] = [
    Placement {
        flag: "--pin",
        name: "on one core, asleep until something comes",
        cores: [0, 0],
        spins: false,
    },
    Placement {
        flag: "--pin2",
        name: "on two cores, asleep until something comes",
        cores: [0, 1],
        spins: false,
    },
    Placement {
        flag: "--spin",
        name: "on two cores, looking for what comes (`spin_us = 50`, and a socket that is read without waiting)",
        cores: [0, 1],
        spins: true,
    },
];

/// The first ones find no route yet.
const UNTIMED: usize = 500;

ctos::command! {
    /// An action.
    struct Note => (), 0x0710, "note"
}
ctos::command! {
    /// When its actions started, ns.
    struct Noted => Vec<u64>, 0x0711, "noted"
}

/// The action `stamp` notes when `act` is enabled: as it ends. `act` is a command to another process.
const SENDS: &str = "net here
place p = 1, q, r
command go -> gone
transition begin
  in p
  tape go
  out q
transition stamp
  in q
  do stamp
  out r
transition act
  in r
  send far.note
  out q
transition never
  in q*2
  out q, p
  write gone
";

/// The same with a token to a net in another process, and one back.
const TOKENS: &str = "net here
place p = 1, q
command go -> gone
transition begin
  in p
  tape go
  out q
transition stamp
  in q
  do stamp
  out r@there
transition never
  in q*2
  out q, p
  write gone
";
const THERE: &str = "net there
place r
transition act
  in r
  do stamp
  out q@here
";

/// When actions started, ns.
#[derive(Clone, Default)]
struct Starts {
    at: Arc<Mutex<Vec<u64>>>,
    /// Told when there are [`ACTIONS`] of them.
    done: Arc<Notify>,
}

impl Starts {
    /// An action starts now.
    fn note(&self, cx: &Context) {
        let now = cx.now().as_nanos();
        let mut at = self.at.lock().unwrap();
        if at.is_empty() {
            at.reserve(ACTIONS);
        }
        if at.len() < ACTIONS {
            at.push(now);
            if at.len() == ACTIONS {
                self.done.notify_one();
            }
        }
    }

    fn all(&self) -> Vec<u64> {
        self.at.lock().unwrap().clone()
    }
}

/// Takes notes, and tells them; a net in the same process takes its own.
struct Far(Starts);

impl EventHandler for Far {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Note::CODE => {
                self.0.note(cx);
                let (Note {}, reply) = message.open::<Note>()?;
                reply.ok(())
            }
            Noted::CODE => {
                let (Noted {}, reply) = message.open::<Noted>()?;
                reply.ok(self.0.all())
            }
            _ => cx.default_processing(message),
        }
    }
}

/// Begins, waits until enough was timed, and ends the app with the times.
struct Watch(Starts);

impl EventHandler for Watch {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase != Phase::Run {
            return Ok(());
        }
        let (cx, enabled) = (cx.clone(), self.0.clone());
        cx.clone().spawn(async move {
            let here = cx.task("here").await.unwrap();
            let far = cx.task("far").await.unwrap();
            let put = PutTape {
                symbol: "go".to_owned(),
                arguments: Vec::new(),
            };
            // Nobody answers it: the net goes round until the app ends.
            let begun = cx.clone();
            cx.spawn(async move { drop(begun.call(&here, put).await) });
            enabled.done.notified().await;
            let enabled = enabled.all();
            let started = cx.call(&far, Noted {}).await.unwrap();
            let pairs = enabled.iter().zip(&started).skip(UNTIMED);
            let times = pairs.map(|(enabled, started)| started.saturating_sub(*enabled));
            let Spread { median, p99 } = Spread::of(times.collect());
            let text = format!("{median} {p99}");
            cx.finish(AppResult {
                ok: true,
                text,
                json: "{}".to_owned(),
            });
        });
        Ok(())
    }
}

/// Median and p99, us.
struct Spread {
    median: f64,
    p99: f64,
}

impl Spread {
    fn of(mut times: Vec<u64>) -> Self {
        times.sort_unstable();
        let at = |share: f64| times[((times.len() - 1) as f64 * share) as usize] as f64 / 1e3;
        Self {
            median: at(0.5),
            p99: at(0.99),
        }
    }
}

impl fmt::Display for Spread {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { median, p99 } = self;
        write!(f, "median {median:>6.1} us, p99 {p99:>6.1} us")
    }
}

fn registry(tokens: bool) -> Registry {
    let mut registry = Registry::new();
    let starts = Starts::default();
    let texts = if tokens {
        [TOKENS, THERE]
    } else {
        [SENDS, THERE]
    };
    for text in texts {
        let net = compile::net(&Source::new("bench.net", text)).unwrap();
        let name = net.name().to_owned();
        let starts = starts.clone();
        registry.handler(&name, &COMMANDS, move |cx| {
            let starts = starts.clone();
            let library = Library::new(()).action("stamp", move |action: Action<()>| {
                starts.note(action.cx());
                async { Ok(()) }
            });
            NetTask::with_settings(cx, net.clone(), library, None, Settings::default())
        });
    }
    let told = starts.clone();
    registry.handler("far", &[Note::INFO, Noted::INFO], move |_| {
        Ok(Far(told.clone()))
    });
    registry.handler("watch", &[], move |_| Ok(Watch(starts.clone())));
    registry
}

fn app(tokens: bool, spins: bool) -> App {
    // A process that is kept on its core from outside never spins.
    let [spin, a, b] = if spins {
        [50, 0, 1].map(|number| number.to_string())
    } else {
        ["0".to_owned(), String::new(), String::new()]
    };
    let processor = |cpu: &str| match cpu {
        "" => "spin_us = 0".to_owned(),
        cpu => format!("cpu = {cpu}, spin_us = 0"),
    };
    let (a, b) = (processor(&a), processor(&b));
    let there = "[task.there]\nhandler = \"there\"\non = \"b\"\n";
    let text = format!(
        "[app]\nname = \"bench\"\nuntil = \"watch\"\nspin_us = {spin}\n[chassis.a]\nprocessors.main = {{ {a} }}\n[chassis.b]\nprocessors.main = {{ {b} }}\n[task.watch]\nhandler = \"watch\"\non = \"a\"\n[task.here]\nhandler = \"here\"\non = \"a\"\n[task.far]\nhandler = \"far\"\non = \"b\"\n{}",
        if tokens { there } else { "" }
    );
    load_texts(&[("app.toml", &text)], &[], &[]).unwrap()
}

fn pin(cpu: usize) {
    let mut set = rustix::thread::CpuSet::new();
    set.set(cpu);
    rustix::thread::sched_setaffinity(None, &set).unwrap();
}

fn launched(tokens: bool, placement: &Placement) -> Spread {
    let words = [
        "running-chassis".to_owned(),
        tokens.to_string(),
        placement.flag.to_owned(),
    ];
    let spins = placement.spins;
    let launcher = Launcher {
        program: std::env::current_exe().unwrap(),
        arguments: words.map(OsString::from).to_vec(),
    };
    let said: Arc<Mutex<Vec<String>>> = Arc::default();
    let hears = said.clone();
    let observer: Observer =
        Arc::new(move |event| hears.lock().unwrap().push(format!("{event:?}")));
    let app = app(tokens, spins);
    let outcome = boot(app, registry(tokens), &launcher, &observer).unwrap();
    match outcome.end {
        End::Finished(result) => {
            let (median, p99) = result.text.split_once(' ').unwrap();
            Spread {
                median: median.parse().unwrap(),
                p99: p99.parse().unwrap(),
            }
        }
        other => panic!("{other:?}: {:#?}", said.lock().unwrap()),
    }
}

/// Takes a byte, asleep until it comes or looking for it.
fn take(stream: &mut TcpStream, byte: &mut [u8; 1]) -> io::Result<()> {
    loop {
        match stream.read(byte) {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(_) => return Ok(()),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => std::hint::spin_loop(),
            Err(error) => return Err(error),
        }
    }
}

fn set_up(stream: &TcpStream, spins: bool) {
    stream.set_nodelay(true).unwrap();
    stream.set_nonblocking(spins).unwrap();
}

/// How long one byte takes from process to process: half of there and back, through TCP.
fn raw(placement: &Placement) -> Spread {
    let Placement {
        cores, spins, flag, ..
    } = *placement;
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let mut child = Process::new(std::env::current_exe().unwrap())
        .args(["running-raw", &address, flag])
        .stdin(Stdio::null())
        .spawn()
        .unwrap();
    let times = move || {
        pin(cores[0]);
        let (mut stream, _) = listener.accept().unwrap();
        set_up(&stream, spins);
        let clock = Clock::real();
        let mut byte = [0];
        let mut times = Vec::with_capacity(ACTIONS);
        for _ in 0..ACTIONS {
            let began = clock.now();
            stream.write_all(&byte).unwrap();
            take(&mut stream, &mut byte).unwrap();
            times.push((clock.now() - began).as_nanos() as u64 / 2);
        }
        times
    };
    // A thread of its own, so that the pin does not outlive it.
    let mut times = std::thread::spawn(times).join().unwrap();
    child.wait().unwrap();
    Spread::of(times.split_off(UNTIMED))
}

fn placement(flag: &str) -> &'static Placement {
    let mut placements = PLACEMENTS.iter();
    placements.find(|one| one.flag == flag).unwrap()
}

/// Does what a further process of the benchmark is to do; whether it was one.
pub fn is_child() -> bool {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        [
            "running-chassis",
            tokens,
            flag,
            _,
            name,
            _,
            address,
            _,
            origin,
        ] => {
            let Placement { cores, spins, .. } = *placement(flag);
            if !spins {
                pin(cores[usize::from(name == "b")]);
            }
            let tokens = tokens.parse().unwrap();
            let boot = address.parse().unwrap();
            let origin = origin.parse().unwrap();
            run_chassis(app(tokens, spins), registry(tokens), name, &boot, origin).unwrap();
            true
        }
        ["running-raw", address, flag] => {
            let Placement { cores, spins, .. } = *placement(flag);
            pin(cores[1]);
            let mut stream = TcpStream::connect(address).unwrap();
            set_up(&stream, spins);
            let mut byte = [0];
            while take(&mut stream, &mut byte).is_ok() {
                stream.write_all(&byte).unwrap();
            }
            true
        }
        _ => false,
    }
}

/// Prints what `arguments` name, or all of it.
pub fn latency(arguments: &[String]) {
    let named = |one: &&Placement| arguments.iter().any(|word| word == one.flag);
    let all = !PLACEMENTS.iter().any(|one| named(&one));
    for placement in PLACEMENTS.iter().filter(|one| all || named(one)) {
        println!(
            "from enabled to the action's start in another process, {} (wanted: p99 below 50 us)",
            placement.name
        );
        let raw = raw(placement);
        println!("  one byte through TCP, one way      {raw}");
        for (what, tokens) in [
            ("a command as the action          ", false),
            ("the action of a net, by a token  ", true),
        ] {
            let spread = launched(tokens, placement);
            let (median, p99) = (spread.median / raw.median, spread.p99 / raw.p99);
            println!("  {what}  {spread}, over TCP {median:.2} and {p99:.2}");
        }
    }
}
