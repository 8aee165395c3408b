//! From the moment in which a transition is enabled to the start of its action in another process: as the
//! command that the action is, and as the action of a net that a token goes to. Both processes on one core, and
//! each on its own; beside the time that one byte takes from process to process through a plain socket.

use std::{
    ffi::OsString,
    io::{Read, Write},
    net::{TcpListener, TcpStream},
    process::{Command as Process, Stdio},
    sync::{Arc, Mutex},
    time::Duration,
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
use pnt::{
    compile,
    library::{Action, Library},
    task::{COMMANDS, NetTask, PutTape, Settings},
};

use super::Starts;

/// Actions whose start is timed.
const ACTIONS: usize = 20_000;

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

/// Takes notes, and tells them; a net in the same process takes its own.
struct Far(Starts);

impl EventHandler for Far {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Note::CODE => {
                self.0.lock().unwrap().push(cx.now().as_nanos());
                let (Note {}, reply) = message.open::<Note>()?;
                reply.ok(())
            }
            Noted::CODE => {
                let (Noted {}, reply) = message.open::<Noted>()?;
                let starts = self.0.lock().unwrap().clone();
                reply.ok(starts)
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
            while enabled.lock().unwrap().len() < ACTIONS {
                cx.sleep(Duration::from_millis(5)).await;
            }
            let enabled = enabled.lock().unwrap().clone();
            let started = cx.call(&far, Noted {}).await.unwrap();
            let pairs = enabled.iter().zip(&started).skip(UNTIMED);
            let times = pairs.map(|(enabled, started)| started.saturating_sub(*enabled));
            let text = spread(times.collect());
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
fn spread(mut times: Vec<u64>) -> String {
    times.sort_unstable();
    let at = |share: f64| times[((times.len() - 1) as f64 * share) as usize] as f64 / 1e3;
    format!("median {:.1} us, p99 {:.1} us", at(0.5), at(0.99))
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
                starts.lock().unwrap().push(action.cx().now().as_nanos());
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

fn app(tokens: bool) -> App {
    let there = "[task.there]\nhandler = \"there\"\non = \"b\"\n";
    let text = format!(
        "[app]\nname = \"bench\"\nuntil = \"watch\"\n[chassis.a]\n[chassis.b]\n[task.watch]\nhandler = \"watch\"\non = \"a\"\n[task.here]\nhandler = \"here\"\non = \"a\"\n[task.far]\nhandler = \"far\"\non = \"b\"\n{}",
        if tokens { there } else { "" }
    );
    load_texts(&[("app.toml", &text)], &[], &[]).unwrap()
}

fn pin(cpu: usize) {
    let mut set = rustix::thread::CpuSet::new();
    set.set(cpu);
    rustix::thread::sched_setaffinity(None, &set).unwrap();
}

fn launched(tokens: bool, cores: [usize; 2]) -> String {
    let words = [
        "running-chassis".to_owned(),
        tokens.to_string(),
        cores[0].to_string(),
        cores[1].to_string(),
    ];
    let launcher = Launcher {
        program: std::env::current_exe().unwrap(),
        arguments: words.map(OsString::from).to_vec(),
    };
    let said: Arc<Mutex<Vec<String>>> = Arc::default();
    let hears = said.clone();
    let observer: Observer =
        Arc::new(move |event| hears.lock().unwrap().push(format!("{event:?}")));
    match boot(app(tokens), registry(tokens), &launcher, &observer)
        .unwrap()
        .end
    {
        End::Finished(result) => result.text,
        other => panic!("{other:?}: {:#?}", said.lock().unwrap()),
    }
}

/// How long one byte takes from process to process: half of there and back, through TCP.
fn raw(cores: [usize; 2]) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let mut child = Process::new(std::env::current_exe().unwrap())
        .args(["running-raw", &address, &cores[1].to_string()])
        .stdin(Stdio::null())
        .spawn()
        .unwrap();
    let times = move || {
        pin(cores[0]);
        let (mut stream, _) = listener.accept().unwrap();
        stream.set_nodelay(true).unwrap();
        let clock = Clock::real();
        let mut byte = [0];
        let mut times = Vec::new();
        for _ in 0..ACTIONS {
            let began = clock.now();
            stream.write_all(&byte).unwrap();
            stream.read_exact(&mut byte).unwrap();
            times.push((clock.now() - began).as_nanos() as u64 / 2);
        }
        times
    };
    // A thread of its own, so that the pin does not outlive it.
    let times = std::thread::spawn(times).join().unwrap();
    child.wait().unwrap();
    spread(times)
}

/// Does what a further process of the benchmark is to do; whether it was one.
pub fn is_child() -> bool {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        [
            "running-chassis",
            tokens,
            a,
            b,
            _,
            name,
            _,
            address,
            _,
            origin,
        ] => {
            let core = if name == "a" { a } else { b };
            pin(core.parse().unwrap());
            let tokens = tokens.parse().unwrap();
            let boot = address.parse().unwrap();
            let origin = origin.parse().unwrap();
            run_chassis(app(tokens), registry(tokens), name, &boot, origin).unwrap();
            true
        }
        ["running-raw", address, core] => {
            pin(core.parse().unwrap());
            let mut stream = TcpStream::connect(address).unwrap();
            stream.set_nodelay(true).unwrap();
            let mut byte = [0];
            while stream.read_exact(&mut byte).is_ok() {
                stream.write_all(&byte).unwrap();
            }
            true
        }
        _ => false,
    }
}

/// Prints all of it.
pub fn latency() {
    for (placed, cores) in [("on one core", [0, 0]), ("on two cores", [0, 1])] {
        println!(
            "from enabled to the action's start in another process, {placed} (wanted: p99 below 50 us)"
        );
        println!("  one byte through TCP, one way      {}", raw(cores));
        println!(
            "  a command as the action            {}",
            launched(false, cores)
        );
        println!(
            "  the action of a net, by a token    {}",
            launched(true, cores)
        );
    }
}
