//! An agent in this process, spoken to in its own words, with scripts in the place of chassis.

use std::{
    collections::BTreeMap, net::SocketAddr, os::unix::fs::PermissionsExt, path::Path, sync::Arc,
    time::Duration,
};

use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
    sync::{mpsc, oneshot},
};

use super::{
    agent::{AgentEvent, AgentSetup, HostAgent},
    call,
    wire::{
        AppFiles, BUNDLE_LIMIT, Connection, FRAME_LIMIT, GREETING, HandlerView, Hello, HelloAnswer,
        LINES_WAITING, Outbox, PROTOCOL, ToAgent, ToBoot, WireError,
    },
};
use crate::boot::launcher::{Briefing, ProcessId};
use crate::doors::{NO_PAGE, STRANGERS, Secret};
use ctos_config::{Bundle, Selection, load};
use ctos_core::registry::Registry;
use ctos_link::{
    handshake::{self, Token},
    transport::Address,
};
use ctos_message::ChassisNumber;

/// A test that takes longer hangs; none takes a fraction of it.
const WATCHDOG: Duration = Duration::from_secs(60);

/// The first process of the first chassis.
const FIRST: ProcessId = ProcessId {
    chassis: 1,
    incarnation: 1,
};

/// After this a hasty boot is missed: long for whatever must have happened before, also on a machine that is busy.
const SILENCE: Duration = Duration::from_secs(3);

/// The time that a process has to end by itself, before it is ended.
const STOP: Duration = Duration::from_millis(300);

fn run<T>(test: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build();
    let test = async { tokio::time::timeout(WATCHDOG, test).await.unwrap() };
    runtime.unwrap().block_on(test)
}

/// An agent whose chassis are a script.
struct Host {
    folder: tempfile::TempDir,
    address: SocketAddr,
    events: mpsc::UnboundedReceiver<String>,
    stop: oneshot::Sender<()>,
    serving: tokio::task::JoinHandle<()>,
}

impl Host {
    async fn start(script: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("chassis.sh");
        std::fs::write(&program, format!("#!/bin/sh\n{script}\n")).unwrap();
        std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o700)).unwrap();
        std::fs::create_dir(folder.path().join("runs")).unwrap();
        let (seen, events) = mpsc::unbounded_channel();
        let setup = AgentSetup {
            listen: ([127, 0, 0, 1], 0).into(),
            key: None,
            folder: folder.path().join("runs"),
            program,
        };
        let observer = Arc::new(move |event: &AgentEvent| {
            // A test may be over.
            let _ = seen.send(serde_json::to_string(event).unwrap());
        });
        let agent = HostAgent::bind(setup, Registry::new(), observer)
            .await
            .unwrap();
        let address = agent.address();
        let (stop, stopped) = oneshot::channel();
        let serving = tokio::spawn(agent.serve(async {
            let _ = stopped.await;
        }));
        Self {
            folder,
            address,
            events,
            stop,
            serving,
        }
    }

    fn runs(&self) -> usize {
        std::fs::read_dir(self.folder.path().join("runs"))
            .unwrap()
            .count()
    }

    /// Stops the agent, which waits for everything that it started: what was seen of it.
    async fn end(mut self) -> Vec<String> {
        self.stop.send(()).unwrap();
        self.serving.await.unwrap();
        let left = std::fs::read_dir(self.folder.path().join("runs")).unwrap();
        assert_eq!(left.count(), 0, "folders are left");
        let mut events = Vec::new();
        while let Some(event) = self.events.recv().await {
            events.push(event);
        }
        events
    }

    /// Waits until it tells something with `text` in it.
    async fn tells(&mut self, text: &str) {
        while !self.events.recv().await.unwrap().contains(text) {}
    }
}

/// A boot that has as much time as the test, and gives as much.
fn hello(run: &str) -> Hello {
    Hello {
        protocol: PROTOCOL,
        version: env!("CARGO_PKG_VERSION").to_owned(),
        run: Token(run.to_owned()),
        replaces: None,
        app: "cell".to_owned(),
        silence_ms: milliseconds(WATCHDOG),
        stop_ms: milliseconds(WATCHDOG),
        secret: None,
    }
}

/// One that ends soon what does not end by itself.
fn strict(run: &str) -> Hello {
    Hello {
        stop_ms: milliseconds(STOP),
        ..hello(run)
    }
}

/// A strict one that is missed soon.
fn hasty(run: &str) -> Hello {
    Hello {
        silence_ms: milliseconds(SILENCE),
        ..strict(run)
    }
}

fn milliseconds(time: Duration) -> u64 {
    u64::try_from(time.as_millis()).unwrap()
}

async fn say_hello(at: SocketAddr, hello: &Hello) -> (TcpStream, HelloAnswer) {
    let mut stream = TcpStream::connect(at).await.unwrap();
    let secret = Secret::of_port(at).ok();
    let hello = Hello {
        secret,
        ..hello.clone()
    };
    stream.write_all(&GREETING).await.unwrap();
    handshake::say(&mut stream, &hello).await.unwrap();
    let answer = handshake::hear(&mut stream).await.unwrap();
    (stream, answer)
}

/// A boot, as far as the agent can tell.
struct Boot {
    connection: Connection,
    outbox: Arc<Outbox<ToAgent>>,
}

impl Boot {
    async fn call(host: &Host, hello: &Hello, expect_known: bool) -> Self {
        let (stream, answer) = say_hello(host.address, hello).await;
        let HelloAnswer::Welcome { known, .. } = answer else {
            panic!("{answer:?}");
        };
        assert_eq!(known, expect_known);
        let outbox = Outbox::new(|_| false);
        let connection = Connection::new(Box::new(stream), outbox.clone(), FRAME_LIMIT, WATCHDOG);
        Self { connection, outbox }
    }

    /// One whose app the agent has.
    async fn with_app(host: &Host, hello: &Hello) -> Self {
        let mut boot = Self::call(host, hello, false).await;
        boot.outbox.say(ToAgent::App(Box::new(files(&[]))));
        assert_eq!(boot.hear().await, ToBoot::Unpacked);
        boot
    }

    async fn hear(&mut self) -> ToBoot {
        self.connection.hear().await.unwrap()
    }

    fn start(&self, chassis: ChassisNumber, incarnation: u32) {
        let briefing = Briefing {
            name: format!("c{chassis}"),
            incarnation,
            origin_ns: 5,
            boot: Address::Tcp(([127, 0, 0, 1], 9).into()),
            token: Token("of the run".to_owned()),
        };
        self.outbox.say(ToAgent::Start(chassis, briefing));
    }

    /// Hears until a process has ended: its lines, and how many there were.
    async fn until_ended(&mut self) -> (Vec<(u64, String)>, u64, Option<i32>) {
        let mut heard = Vec::new();
        loop {
            match self.hear().await {
                ToBoot::Line(_, number, text) => heard.push((number, text)),
                ToBoot::Ended(_, ending, lines) => return (heard, lines, ending.code),
                _ => {}
            }
        }
    }
}

fn files(handlers: &[HandlerView]) -> AppFiles {
    AppFiles {
        bundle: Bundle {
            selection: Selection {
                file: "app.toml".into(),
                profiles: vec!["p".to_owned()],
                sets: vec!["app.seed=3".to_owned()],
            },
            files: BTreeMap::from([("app.toml".to_owned(), "[app]\n".to_owned())]),
            variables: BTreeMap::from([
                ("CTOS_TEST_ARM".to_owned(), Some("left".to_owned())),
                ("HOME".to_owned(), None),
            ]),
        },
        options: vec!["--quiet".to_owned()],
        handlers: handlers.to_vec(),
        recorded: false,
    }
}

#[test]
fn a_chassis_is_started_with_the_app_its_files_and_its_variables() {
    run(async {
        let script = r#"echo "$@" >&2; cat "$2" >&2; echo "$CTOS_TEST_ARM ${HOME-unset} $CTOS_RUN_TOKEN $CTOS_INCARNATION" >&2; exit 3"#;
        let host = Host::start(script).await;
        let mut boot = Boot::with_app(&host, &hello("r")).await;
        boot.start(2, 7);
        let (heard, lines, code) = boot.until_ended().await;
        assert_eq!((lines, code), (3, Some(3)));
        let texts: Vec<&str> = heard.iter().map(|(_, text)| text.as_str()).collect();
        assert!(texts[0].starts_with("chassis /"), "{texts:?}");
        let rest = "app.toml --profile p --set app.seed=3 --quiet --chassis c2 --boot tcp:127.0.0.1:9 --origin 5";
        assert!(texts[0].ends_with(rest), "{texts:?}");
        assert_eq!(texts[1..], ["[app]", "left unset of the run 7"]);
        boot.outbox.say(ToAgent::Bye);
        assert_eq!(boot.hear().await, ToBoot::Over);
        assert_eq!(host.runs(), 0);
        drop(boot);
        host.end().await;
    });
}

#[test]
fn lines_are_numbered_and_those_that_do_not_fit_are_missing_from_the_count_only() {
    run(async {
        let count = 40_000;
        let host = Host::start(&format!("seq 1 {count} >&2")).await;
        let mut boot = Boot::with_app(&host, &hello("r")).await;
        boot.start(1, 1);
        let (heard, lines, _) = boot.until_ended().await;
        assert_eq!(lines, count);
        assert!(
            heard
                .iter()
                .all(|(number, text)| number.to_string() == *text)
        );
        assert!(heard.is_sorted(), "out of order");
        assert!(heard.len() >= LINES_WAITING.min(1000), "{}", heard.len());
        drop(boot);
        host.end().await;
    });
}

#[test]
fn an_outbox_keeps_lines_up_to_its_limit_and_everything_else() {
    let outbox = Outbox::new(ToBoot::may_be_dropped);
    for number in 0..3 * LINES_WAITING as u64 {
        outbox.say(ToBoot::Line(FIRST, number, String::new()));
        outbox.say(ToBoot::Unpacked);
    }
    assert_eq!(outbox.len(), LINES_WAITING + 3 * LINES_WAITING);
}

#[test]
fn a_boot_that_comes_back_in_time_finds_its_processes_as_they_are() {
    run(async {
        // Both end with their hold on the agent; the second one does so at once.
        let host = Host::start(r#"case " $* " in *" c2 "*) exit 4;; esac; echo up >&2; cat"#).await;
        let mut boot = Boot::with_app(&host, &hello("r")).await;
        boot.start(1, 1);
        boot.start(2, 1);
        let (_, _, code) = boot.until_ended().await;
        assert_eq!(code, Some(4));
        drop(boot);
        let mut boot = Boot::call(&host, &hello("r"), true).await;
        let mut seen = Vec::new();
        while seen.len() < 2 {
            match boot.hear().await {
                ToBoot::Started(id, _) => seen.push((id.chassis, None)),
                ToBoot::Ended(id, ending, _) => seen.push((id.chassis, ending.code)),
                _ => {}
            }
        }
        assert_eq!(seen, [(1, None), (2, Some(4))]);
        // What was started is not started again.
        boot.start(1, 1);
        // Lines of its log may come before.
        while !matches!(boot.hear().await, ToBoot::Started(FIRST, _)) {}
        boot.outbox.say(ToAgent::Bye);
        let (_, _, code) = boot.until_ended().await;
        assert_eq!(code, Some(0), "it was let go, and ended by itself");
        assert_eq!(boot.hear().await, ToBoot::Over);
        drop(boot);
        let events = host.end().await;
        let started = events
            .iter()
            .filter(|event| event.contains("started"))
            .count();
        assert_eq!(started, 2, "{events:?}");
    });
}

#[test]
fn nothing_of_a_lost_run_is_left_when_the_one_that_replaces_it_begins() {
    run(async {
        let mut host = Host::start("trap '' TERM; echo up >&2; while :; do sleep 1000; done").await;
        let mut lost = Boot::with_app(&host, &strict("lost")).await;
        lost.start(1, 1);
        while !matches!(lost.hear().await, ToBoot::Line(..)) {}
        let hello = Hello {
            replaces: Some(Token("lost".to_owned())),
            ..hello("r")
        };
        let (stream, answer) = say_hello(host.address, &hello).await;
        assert!(matches!(answer, HelloAnswer::Welcome { known: false, .. }));
        let outbox = Outbox::new(|_| false);
        let connection = Connection::new(Box::new(stream), outbox.clone(), FRAME_LIMIT, WATCHDOG);
        let mut anew = Boot { connection, outbox };
        anew.outbox.say(ToAgent::App(Box::new(files(&[]))));
        assert_eq!(anew.hear().await, ToBoot::Unpacked);
        assert_eq!(host.runs(), 1);
        host.tells("was killed by signal 9").await;
        host.tells("its boot has begun anew").await;
        drop(anew);
        host.end().await;
    });
}

#[test]
fn what_a_boot_leaves_behind_is_ended_also_when_it_does_not_want_to() {
    run(async {
        // Neither the loss of its hold nor SIGTERM ends it.
        let mut host = Host::start("trap '' TERM; echo up >&2; while :; do sleep 1000; done").await;
        let mut boot = Boot::with_app(&host, &hasty("r")).await;
        boot.start(1, 1);
        while !matches!(boot.hear().await, ToBoot::Line(..)) {}
        drop(boot);
        host.tells("was killed by signal 9").await;
        host.tells("its boot is gone").await;
        assert_eq!(host.runs(), 0);
        host.end().await;
    });
}

#[test]
fn a_boot_that_is_silent_is_gone_although_its_connection_is_there() {
    run(async {
        let host = Host::start("cat").await;
        let mut boot = Boot::with_app(&host, &hasty("r")).await;
        boot.start(1, 1);
        // It says nothing from here on, and is hung up on.
        while boot.connection.hear::<ToBoot>().await.is_ok() {}
        drop(boot);
        let events = host.end().await.join("\n");
        assert!(events.contains("nothing was heard of it"), "{events}");
    });
}

#[test]
fn another_version_is_refused_with_both() {
    run(async {
        let host = Host::start("exit 0").await;
        for (protocol, version) in [
            (PROTOCOL + 1, env!("CARGO_PKG_VERSION")),
            (PROTOCOL, "9.9.9"),
        ] {
            let hello = Hello {
                protocol,
                version: version.to_owned(),
                ..hello("r")
            };
            let (mut stream, answer) = say_hello(host.address, &hello).await;
            let HelloAnswer::Refused { reason } = answer else {
                panic!("{answer:?}");
            };
            assert!(
                reason.contains(version) && reason.contains("install the same"),
                "{reason}"
            );
            assert_eq!(stream.read(&mut [0; 8]).await.unwrap(), 0);
        }
        let events = host.end().await;
        assert_eq!(
            events
                .iter()
                .filter(|event| event.contains("refused"))
                .count(),
            2
        );
    });
}

#[test]
fn an_app_whose_handlers_the_agent_has_otherwise_is_refused() {
    run(async {
        let host = Host::start("exit 0").await;
        let mut boot = Boot::call(&host, &hello("r"), false).await;
        let handler = HandlerView {
            name: "arm".to_owned(),
            commands: vec![(1, "go".to_owned())],
        };
        boot.outbox.say(ToAgent::App(Box::new(files(&[handler]))));
        let ToBoot::Refused { reason } = boot.hear().await else {
            panic!("not refused");
        };
        assert!(reason.contains("no event handler `arm`"), "{reason}");
        drop(boot);
        host.end().await;
    });
}

#[test]
fn an_agent_without_keys_starts_nothing_for_who_does_not_know_the_secret_of_its_port() {
    run(async {
        let mut host = Host::start("exit 0").await;
        for secret in [None, serde_json::from_str("\"00ff\"").unwrap()] {
            let mut stream = TcpStream::connect(host.address).await.unwrap();
            let hello = Hello {
                secret,
                ..hello("r")
            };
            stream.write_all(&GREETING).await.unwrap();
            handshake::say(&mut stream, &hello).await.unwrap();
            let HelloAnswer::Refused { reason } = handshake::hear(&mut stream).await.unwrap()
            else {
                panic!("not refused");
            };
            assert!(
                reason.contains("the secret of the agent's port"),
                "{reason}"
            );
            host.tells("the secret of the agent's port").await;
        }
        host.end().await;
    });
}

#[test]
fn a_browser_at_an_agent_is_told_that_it_is_no_page_and_idle_strangers_keep_no_boot_out() {
    run(async {
        let host = Host::start("exit 0").await;
        let mut idle = Vec::new();
        for _ in 0..STRANGERS + 6 {
            idle.push(TcpStream::connect(host.address).await.unwrap());
        }
        let mut browser = TcpStream::connect(host.address).await.unwrap();
        let get = b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n";
        browser.write_all(get).await.unwrap();
        browser.shutdown().await.unwrap();
        let mut answer = String::new();
        browser.read_to_string(&mut answer).await.unwrap();
        assert_eq!(answer, NO_PAGE);
        drop(Boot::call(&host, &hello("r"), false).await);
        host.end().await;
    });
}

#[test]
fn what_is_too_long_or_unreadable_ends_its_own_run_alone() {
    run(async {
        let host = Host::start("cat").await;
        let mut good = Boot::with_app(&host, &hello("good")).await;
        good.start(1, 1);
        assert!(matches!(good.hear().await, ToBoot::Started(..)));
        let too_long = u32::try_from(BUNDLE_LIMIT + 1).unwrap().to_le_bytes();
        let rubbish = [&3_u32.to_le_bytes()[..], &[0xff; 3]].concat();
        for bytes in [&too_long[..], &rubbish, &[0xff; 64]] {
            let (mut stream, answer) = say_hello(host.address, &hello("bad")).await;
            assert!(matches!(answer, HelloAnswer::Welcome { known: false, .. }));
            stream.write_all(bytes).await.unwrap();
            let mut rest = Vec::new();
            let _ = stream.read_to_end(&mut rest).await;
        }
        good.outbox.say(ToAgent::Ping { number: 9 });
        loop {
            if matches!(good.hear().await, ToBoot::Pong { number: 9, .. }) {
                break;
            }
        }
        // After the app no frame may be that long.
        good.outbox.say(ToAgent::App(Box::new(AppFiles {
            options: vec!["x".repeat(FRAME_LIMIT)],
            ..files(&[])
        })));
        let over = loop {
            match good.connection.hear::<ToBoot>().await {
                Ok(_) => {}
                Err(error) => break error,
            }
        };
        assert!(
            matches!(over, WireError::HungUp | WireError::Io(_)),
            "{over}"
        );
        drop(good);
        host.end().await;
    });
}

#[test]
fn a_bundle_that_would_write_elsewhere_is_refused() {
    run(async {
        let host = Host::start("exit 0").await;
        let mut boot = Boot::call(&host, &hello("r"), false).await;
        let mut evil = files(&[]);
        evil.bundle
            .files
            .insert("../evil".to_owned(), "x".to_owned());
        boot.outbox.say(ToAgent::App(Box::new(evil)));
        assert!(matches!(boot.hear().await, ToBoot::Refused { .. }));
        assert!(!host.folder.path().join("runs/evil").exists());
        drop(boot);
        host.end().await;
    });
}

#[test]
fn an_app_whose_files_are_too_many_is_not_sent() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write(
        "app.toml",
        "[chassis.a]\n[task.t]\nhandler = \"h\"\non = \"a\"\n",
    );
    write("table.csv", &"x".repeat(BUNDLE_LIMIT));
    let app = load(&folder.path().join("app.toml"), &[], &[]).unwrap();
    assert!(call::files(&app, &Registry::new(), &[]).is_ok());
    app.read(Path::new("table.csv")).unwrap();
    let refused = call::files(&app, &Registry::new(), &[]).unwrap_err();
    assert!(refused.contains("an agent takes less than 64"), "{refused}");
}

/// Whatever a boot, an agent or a tool may send is a value or an error.
pub(crate) fn fuzz(bytes: &[u8]) {
    let _ = postcard::from_bytes::<Hello>(bytes);
    let _ = postcard::from_bytes::<HelloAnswer>(bytes);
    let _ = postcard::from_bytes::<ToBoot>(bytes);
    let _ = serde_json::from_slice::<crate::control::protocol::Ask>(bytes);
    if let Ok(ToAgent::App(files)) = postcard::from_bytes(bytes) {
        // What would be laid down is read first.
        let _ = files.bundle.load(&[]);
    }
}

/// What this version itself writes.
pub(crate) fn corpus() -> Vec<Vec<u8>> {
    let app = ToAgent::App(Box::new(files(&[HandlerView {
        name: "arm".to_owned(),
        commands: vec![(1, "go".to_owned())],
    }])));
    let ended = ToBoot::Ended(
        FIRST,
        crate::boot::spawn::Ending {
            how: "ended".to_owned(),
            code: Some(1),
            by_signal: false,
        },
        3,
    );
    vec![
        postcard::to_stdvec(&hello("r")).unwrap(),
        postcard::to_stdvec(&app).unwrap(),
        postcard::to_stdvec(&ended).unwrap(),
        br#"{"version":1,"request":{"kind":"logs","name":"arm","follow":true}}"#.to_vec(),
    ]
}
