//! Two apps with processes of their own, joined by TLS over a way that is cut. A task of one of them makes and cuts the way, asks
//! the other site, and tells all that came of it.
//!
//! Its own `main`, because the chassis are processes of this program.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "all of this is test code, helpers too, which fails by panicking"
)]

use std::{
    ffi::OsString,
    io::{Read as _, Write as _},
    net::{Shutdown, TcpListener, TcpStream},
    path::{Path, PathBuf},
    process::ExitCode,
    sync::{Arc, Condvar, Mutex},
    time::Duration,
};

use bridge_sites::{SiteExpander, register};
use ctos::{
    boot::{Address, BootEvent, End, Launcher, Observer, boot, run_chassis},
    call::{CallError, Fault},
    config::{App, Expander, Selection},
    message::Command,
    registry::Registry,
    security::{Role, make_key},
    system::AppResult,
    task::{Context, Handled, HandlerError, Phase},
};
use libtest_mimic::{Arguments, Failed, Trial};
use pnt::{
    library::Library,
    stream::Describe,
    task::{Marking, PutTape, ReadTape},
};
use serde::{Deserialize, Serialize};

/// The first argument of a process that is a chassis and not the tests.
const CHASSIS: &str = "joined-chassis";

const NORTH: &str = r#"
app.name = "north"
app.until = "end"
[security]
key = "keys/north"
authority = "keys/ca.pem"
[chassis.desk]
[chassis.gate]
restart = "on-failure"
[task.end]
handler = "end"
on = "desk"
[task.depot]
handler = "net"
on = "desk"
args = { net = "depot.net", durable = true }
[task.hidden]
handler = "net"
on = "desk"
args = { net = "hidden.net", durable = true }
[site]
name = "north"
on = "gate"
listen = ["tls/127.0.0.1:FAR"]
[site.allow.south]
depot = ["tokens", "put_tape", "marking", "read_tape"]
end = ["*"]
"#;

const SOUTH: &str = r#"
app.name = "south"
app.until = "person"
[security]
key = "keys/south"
authority = "keys/ca.pem"
[chassis.desk]
[chassis.gate]
restart = "on-failure"
[task.person]
handler = "person"
on = "desk"
args = { near = NEAR, far = FAR, cut_s = CUT }
[task.shop]
handler = "net"
on = "desk"
args = { net = "shop.net", durable = true, forward = { parcel = "depot@north" } }
[site]
name = "south"
on = "gate"
connect = ["tls/127.0.0.1:NEAR"]
[site.reach.north]
depot = "net"
hidden = "net"
end = "end"
"#;

const SHOP: &str = "net shop\nplace free = 1, packed\ncommand order(what : text) -> parcel\ntransition pack\n  in free\n  tape order\n  out packed\ntransition send_off\n  in packed\n  out free\n  write parcel\n";
const DEPOT: &str = "net depot\nplace free = 1, here\ncommand parcel(what : text) -> stored\ntransition take_in\n  in free\n  tape parcel\n  out here\ntransition store\n  in here\n  out free\n  write stored\n";

/// Ends the app of north, and tells for how long it ran.
#[derive(Serialize, Deserialize, Command)]
#[command(code = 0x0001, name = "end")]
struct Finish {}

struct Ender;

#[ctos::handler]
impl Ender {
    #[command]
    fn end(&mut self, cx: &Context, _: Finish) {
        let text = "asked to end".to_owned();
        cx.finish(AppResult {
            ok: true,
            text,
            json: String::new(),
        });
    }
}

/// The way between the sites. Cut, it keeps the bytes where they are; connections are neither made nor ended.
#[derive(Clone, Default)]
struct Way(Arc<(Mutex<bool>, Condvar)>);

impl Way {
    fn between(near: u16, far: u16) -> Self {
        let (way, listener) = (
            Self::default(),
            TcpListener::bind(("127.0.0.1", near)).unwrap(),
        );
        let here = way.clone();
        std::thread::spawn(move || {
            for from in listener.incoming().flatten() {
                here.wait();
                let Ok(to) = TcpStream::connect(("127.0.0.1", far)) else {
                    continue;
                };
                here.carry(from.try_clone().unwrap(), to.try_clone().unwrap());
                here.carry(to, from);
            }
        });
        way
    }

    /// Waits until it is whole.
    fn wait(&self) {
        let (cut, changed) = &*self.0;
        drop(changed.wait_while(cut.lock().unwrap(), |cut| *cut).unwrap());
    }

    fn carry(&self, mut from: TcpStream, mut to: TcpStream) {
        let way = self.clone();
        to.set_nodelay(true).unwrap();
        std::thread::spawn(move || {
            let mut bytes = [0; 1 << 16];
            while let Ok(read @ 1..) = from.read(&mut bytes) {
                way.wait();
                if to.write_all(&bytes[..read]).is_err() {
                    break;
                }
            }
            way.wait();
            // Each end is told when the other has gone, which may be known already.
            let _ = from.shutdown(Shutdown::Both);
            let _ = to.shutdown(Shutdown::Both);
        });
    }

    fn set(&self, is_cut: bool) {
        let (cut, changed) = &*self.0;
        *cut.lock().unwrap() = is_cut;
        changed.notify_all();
    }
}

#[derive(Clone, Copy, Deserialize)]
struct Args {
    near: u16,
    far: u16,
    cut_s: f64,
}

struct Person {
    args: Args,
}

/// Asks a task of any site.
async fn ask<C: Command>(cx: &Context, task: &str, request: C) -> Result<C::Reply, CallError> {
    let found = cx.task(task).await.expect("there is a stand-in");
    cx.call(&found, request)
        .deadline(Duration::from_secs(60))
        .await
}

/// Orders that the shop packs and sends on.
async fn order(cx: &Context, numbers: std::ops::Range<u32>) {
    for number in numbers {
        let put = PutTape {
            symbol: "order".to_owned(),
            arguments: vec![number.to_string()],
        };
        let answer = ask(cx, "shop", put).await.expect("the shop packs");
        assert_eq!(answer.symbol, "parcel");
    }
}

async fn waiting(cx: &Context) -> u32 {
    let shop = ask(cx, "shop", Marking {}).await.expect("the shop tells");
    shop.sending.iter().map(|(_, waiting)| waiting).sum()
}

async fn all_arrived(cx: &Context) {
    while waiting(cx).await > 0 {
        cx.sleep(Duration::from_millis(50)).await;
    }
}

/// What each step came to.
async fn story(cx: &Context, args: Args) -> Result<String, HandlerError> {
    let mut told = Vec::new();
    let way = Way::between(args.near, args.far);
    while ask(cx, "depot@north", Marking {}).await.is_err() {
        cx.sleep(Duration::from_millis(100)).await;
    }
    let refused = ask(cx, "depot@north", Describe {})
        .await
        .map(drop)
        .unwrap_err();
    told.push(refused.to_string());
    let hidden = ask(cx, "hidden@north", Marking {})
        .await
        .map(drop)
        .unwrap_err();
    told.push(hidden.to_string());
    let mut calls = Vec::new();
    for _ in 0..200 {
        let begun = cx.now();
        ask(cx, "depot@north", Marking {}).await?;
        calls.push(cx.now().since(begun));
    }
    calls.sort_unstable();
    order(cx, 0..3).await;
    all_arrived(cx).await;

    way.set(true);
    let begun = cx.now();
    let noticed = ask(cx, "depot@north", Marking {})
        .await
        .map(drop)
        .unwrap_err();
    let after = cx.now().since(begun);
    assert!(
        after < Duration::from_secs(30),
        "long before its deadline: {after:?}"
    );
    assert!(
        matches!(noticed.fault, Fault::CutOff { asked: true, .. }),
        "{noticed:?}"
    );
    told.push(noticed.to_string());
    order(cx, 3..6).await;
    cx.sleep(Duration::from_secs_f64(args.cut_s)).await;
    let at_once = ask(cx, "depot@north", Marking {})
        .await
        .map(drop)
        .unwrap_err();
    let Fault::CutOff {
        asked: false,
        after,
        ..
    } = at_once.fault
    else {
        panic!("{at_once:?}")
    };
    assert!(
        after.as_secs_f64() >= args.cut_s,
        "it tells the whole cut: {after:?}"
    );
    told.push(at_once.to_string());
    assert_eq!(waiting(cx).await, 3, "they wait");

    way.set(false);
    let begun = cx.now();
    order(cx, 6..8).await;
    all_arrived(cx).await;
    let healed = cx.now().since(begun);
    let tape = ask(cx, "depot@north", ReadTape { taken: 0 }).await?;
    let stored: Vec<_> = tape.iter().map(|one| one.arguments.join(" ")).collect();
    told.push(format!("stored {}", stored.join(" ")));
    told.push(format!(
        "a call took {:?}; whole again after {healed:?}",
        calls[calls.len() / 2]
    ));
    ask(cx, "end@north", Finish {}).await?;
    Ok(told.join("\n"))
}

#[ctos::handler]
impl Person {
    #[phase]
    async fn enters(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (cx, args) = (cx.clone(), self.args);
            cx.clone().spawn(async move {
                match story(&cx, args).await {
                    Ok(text) => cx.finish(AppResult {
                        ok: true,
                        text,
                        json: String::new(),
                    }),
                    Err(error) => cx.fail(&error.to_string()),
                }
            });
        }
        Ok(())
    }
}

fn registry() -> Registry {
    let mut registry = Registry::new();
    registry.handler("end", &Ender::COMMANDS, |_| Ok(Ender));
    registry.handler("person", &Person::COMMANDS, |cx| {
        Ok(Person { args: cx.args()? })
    });
    pnt::task::register(&mut registry, "net", || Library::new(()));
    pnt::store::keep_states(&mut registry);
    register(&mut registry);
    registry
}

fn app(file: PathBuf) -> App {
    let selection = Selection {
        file,
        ..Selection::default()
    };
    let extra: [(&'static str, &dyn Expander); 1] = [("site", &SiteExpander)];
    selection
        .load(&extra)
        .unwrap_or_else(|findings| panic!("{findings}"))
}

/// Boots an app; what it came to, or its log.
fn run(file: PathBuf) -> Result<String, String> {
    let launcher = Launcher {
        program: std::env::current_exe().unwrap(),
        arguments: [OsString::from(CHASSIS), file.clone().into()].to_vec(),
    };
    let log: Arc<Mutex<Vec<String>>> = Arc::default();
    let lines = log.clone();
    let observer: Observer = Arc::new(move |event| {
        if let BootEvent::Log { line, .. } = event {
            lines.lock().unwrap().push(line.clone());
        }
    });
    let outcome = boot(app(file), registry(), &launcher, &observer);
    let log = log.lock().unwrap().join("\n");
    match outcome.map(|outcome| outcome.end) {
        Ok(End::Finished(result)) if result.ok => Ok(result.text),
        other => Err(format!("{other:?}\n{log}")),
    }
}

/// Ports that nobody has at the moment.
fn free_ports() -> [u16; 2] {
    let listeners = [(); 2].map(|()| TcpListener::bind(("127.0.0.1", 0)).unwrap());
    listeners.map(|listener| listener.local_addr().unwrap().port())
}

fn write(folder: &Path, file: &str, text: &str) -> PathBuf {
    let file = folder.join(file);
    std::fs::write(&file, text).unwrap();
    file
}

fn cut(cut_s: f64) -> Result<(), Failed> {
    let folder = tempfile::tempdir()?;
    let folder = folder.path();
    for site in ["north", "south"] {
        make_key(&folder.join("keys").join(site), Role::Boot)?;
        std::fs::create_dir(folder.join(site))?;
    }
    let [near, far] = free_ports();
    let filled = |text: &str| {
        let text = text.replace("\"keys/", "\"../keys/");
        let text = text.replace("NEAR", &near.to_string());
        let text = text.replace("FAR", &far.to_string());
        text.replace("CUT", &format!("{cut_s:?}"))
    };
    write(folder, "north/depot.net", DEPOT);
    write(
        folder,
        "north/hidden.net",
        &DEPOT.replace("net depot", "net hidden"),
    );
    write(folder, "south/shop.net", SHOP);
    let north = write(folder, "north/app.toml", &filled(NORTH));
    let south = write(folder, "south/app.toml", &filled(SOUTH));
    let north = std::thread::spawn(move || run(north));
    let told = run(south)?;
    let ended = north.join().expect("the boot of north ends")?;
    if ended != "asked to end" {
        return Err(ended.into());
    }
    // For whoever measures: `--nocapture` shows it.
    writeln!(std::io::stderr(), "{told}")?;
    let lines: Vec<_> = told.lines().collect();
    let expected = [
        "site `north` lets site `south` not ask `describe_net` of `depot`, only tokens, put_tape, marking, read_tape",
        "site `north` lets site `south` ask nothing of `hidden`: its [site.allow.south] does not name it",
        "`depot@north` has not answered `marking` from `person`, and may have carried it out",
        "`depot@north` was not asked for `marking` by `person`",
        "stored 0 1 2 3 4 5 6 7",
    ];
    for (line, expected) in lines.iter().zip(expected) {
        if !line.contains(expected) {
            return Err(format!("no `{expected}` in\n{told}").into());
        }
    }
    for line in &lines[2..4] {
        if !line.starts_with("site `north` has been cut off for ") {
            return Err(told.into());
        }
    }
    Ok(())
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if arguments.first().is_some_and(|first| first == CHASSIS) {
        return chassis(&arguments);
    }
    let name = |time: &str| {
        format!("in_a_cut_of_{time}_calls_are_told_of_it_and_tokens_arrive_once_after_it")
    };
    let trials = vec![
        Trial::test(name("a_second"), || cut(1.0)),
        Trial::test(name("a_minute"), || cut(60.0)).with_ignored_flag(true),
        Trial::test(name("ten_minutes"), || cut(600.0)).with_ignored_flag(true),
    ];
    libtest_mimic::run(&Arguments::from_args(), trials).exit_code()
}

/// The process of one chassis: `joined-chassis FILE --chassis NAME --boot ADDRESS --origin NS`.
fn chassis(arguments: &[String]) -> ExitCode {
    let [_, file, _, name, _, address, _, origin] = arguments else {
        return ExitCode::from(2);
    };
    let (Ok(address), Ok(origin)) = (address.parse::<Address>(), origin.parse()) else {
        return ExitCode::from(2);
    };
    match run_chassis(app(file.into()), registry(), name, &address, origin) {
        Ok(code) => ExitCode::from(u8::try_from(code).unwrap_or(255)),
        Err(error) => {
            // The boot shows what a chassis writes there.
            let _ = writeln!(std::io::stderr(), "{error}");
            ExitCode::from(4)
        }
    }
}
