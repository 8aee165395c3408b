//! The server and clients that mean no good, or are too many.

use std::{
    io::{Read, Write},
    net::{SocketAddr, TcpListener, TcpStream},
    thread::JoinHandle,
    time::Duration,
};

use tungstenite::{Message, WebSocket, protocol::frame::coding::CloseCode};

use super::*;
use crate::overview::Overviews;
use ctos::time::Clock;

/// A server that says nothing for so long has failed the test.
const SILENCE: Duration = Duration::from_secs(30);

struct Served {
    address: SocketAddr,
    hub: Arc<Hub>,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

/// A server whose app has ended.
fn served(viewers: usize) -> Served {
    served_to(viewers, mpsc::channel(1).0)
}

fn served_to(viewers: usize, orders: mpsc::Sender<Asking>) -> Served {
    let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
    let address = listener.local_addr().unwrap();
    let pages = Pages::new(listener, None, &[]).unwrap();
    let hub = Arc::new(Hub::live(
        "app",
        Overviews::default(),
        Clock::virtual_clock(),
    ));
    let service = Service {
        hub: Arc::clone(&hub),
        door: Door {
            token: Some("secret".to_owned()),
            anybody_looks: true,
            allow_control: true,
            ..Door::default()
        },
        viewers,
        permits: permits(viewers),
        orders,
    };
    let (stop, stopped) = oneshot::channel();
    let thread = std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .unwrap();
        runtime.block_on(serve(pages, service, stopped)).unwrap();
    });
    Served {
        address,
        hub,
        stop: Some(stop),
        thread: Some(thread),
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.stop.take().unwrap().send(());
        self.thread.take().unwrap().join().unwrap();
    }
}

impl Served {
    fn viewer(&self) -> WebSocket<TcpStream> {
        let stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(SILENCE)).unwrap();
        let url = format!("ws://{}/ws?token=secret", self.address);
        tungstenite::client(url, stream).unwrap().0
    }
}

fn next(viewer: &mut WebSocket<TcpStream>) -> String {
    match viewer.read().unwrap() {
        Message::Text(text) => text.to_string(),
        other => panic!("{other:?}"),
    }
}

/// Code and reason with which a connection is closed.
fn ended(viewer: &mut WebSocket<TcpStream>) -> (CloseCode, String) {
    loop {
        if let Message::Close(frame) = viewer.read().unwrap() {
            let frame = frame.unwrap();
            return (frame.code, frame.reason.to_string());
        }
    }
}

#[test]
fn one_viewer_too_many_is_told_so_and_may_come_when_another_has_gone() {
    let served = served(2);
    let mut first = served.viewer();
    let mut second = served.viewer();
    assert!(next(&mut first).contains("hello") && next(&mut second).contains("hello"));
    let third = ended(&mut served.viewer());
    assert_eq!(third, (CloseCode::Again, "2 look on already".to_owned()));
    second.close(None).unwrap();
    while second.read().is_ok() {}
    // The server hears of it in its own time.
    while !matches!(served.viewer().read().unwrap(), Message::Text(_)) {}
    // Nobody else noticed.
    first
        .send(Message::text(r#"{"kind":"fire","id":7}"#))
        .unwrap();
    assert!(next(&mut first).contains("\"id\":7"));
}

#[test]
fn what_is_no_message_ends_the_connection_that_it_came_by_with_the_reason_and_no_other() {
    let served = served(8);
    let mut good = served.viewer();
    next(&mut good);
    let bad = |message: Message| {
        let mut viewer = served.viewer();
        next(&mut viewer);
        // The server may close before it has all.
        let _ = viewer.send(message);
        ended(&mut viewer)
    };
    let (code, reason) = bad(Message::text("{"));
    assert_eq!(code, CloseCode::Policy);
    assert!(reason.contains("cannot be read"), "{reason}");
    let (code, reason) = bad(Message::text(r#"{"kind":3}"#));
    assert_eq!(code, CloseCode::Policy);
    assert!(reason.contains("cannot be read"), "{reason}");
    assert_eq!(bad(Message::binary(vec![1])).0, CloseCode::Unsupported);
    let (code, reason) = bad(Message::text("x".repeat(LONGEST + 1)));
    assert_eq!(code, CloseCode::Size);
    assert!(reason.contains("too long"), "{reason}");
    // A frame that the protocol does not have: reserved bits, without a mask.
    let mut viewer = served.viewer();
    next(&mut viewer);
    viewer
        .get_mut()
        .write_all(&[0xff, 0x05, 1, 2, 3, 4, 5])
        .unwrap();
    let (code, reason) = ended(&mut viewer);
    assert_eq!(code, CloseCode::Protocol);
    assert!(!reason.is_empty());

    good.send(Message::text(r#"{"kind":"fire","id":9}"#))
        .unwrap();
    assert!(next(&mut good).contains("\"id\":9"));
}

#[test]
fn a_command_that_takes_long_keeps_its_browser_from_nothing_and_is_answered_when_it_is_done() {
    let (orders, mut asked) = mpsc::channel(1);
    let served = served_to(1, orders);
    let mut viewer = served.viewer();
    next(&mut viewer);
    let mut ask = |text: &str| viewer.send(Message::text(text)).unwrap();
    ask(r#"{"kind":"command","net":"n","words":["carry","3,4","4,5"],"id":1}"#);
    ask(r#"{"kind":"pause","net":"n","id":2}"#);
    let (command, done) = asked.blocking_recv().unwrap();
    assert_eq!(command.words, ["carry", "3,4", "4,5"]);
    let (pause, paused) = asked.blocking_recv().unwrap();
    assert_eq!(pause.kind, "pause");
    paused.send("second".to_owned()).unwrap();
    assert_eq!(next(&mut viewer), "second");
    done.send("first".to_owned()).unwrap();
    assert_eq!(next(&mut viewer), "first");
    // Who asks for too much is told so.
    for id in 0..=MOST_ASKED {
        let text = format!(r#"{{"kind":"command","net":"n","words":["carry"],"id":{id}}}"#);
        viewer.send(Message::text(text)).unwrap();
    }
    let told = next(&mut viewer);
    assert!(
        told.contains(&format!("\"id\":{MOST_ASKED}")) && told.contains("already"),
        "{told}"
    );
}

#[test]
fn a_request_that_is_none_is_answered_or_let_go_and_the_page_is_served_all_the_same() {
    let served = served(1);
    let ask = |bytes: &[u8]| {
        let mut stream = TcpStream::connect(served.address).unwrap();
        stream.set_read_timeout(Some(SILENCE)).unwrap();
        stream.write_all(bytes).unwrap();
        stream.shutdown(std::net::Shutdown::Write).unwrap();
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        String::from_utf8_lossy(&answer).into_owned()
    };
    assert!(!ask(b"\0\x01\x02nonsense\r\n\r\n").contains(" 200 "));
    assert!(!ask(&[b'A'; 100_000]).contains(" 200 "));
    let get =
        |path: &str| format!("GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n");
    assert!(ask(get("/..%2f..%2fCargo.toml").as_bytes()).contains(" 404 "));
    let page = ask(get("/").as_bytes());
    assert!(
        page.contains(" 200 ") && page.contains("frame-ancestors 'none'"),
        "{page}"
    );
}

#[test]
fn ten_viewers_are_told_the_same_beside_those_that_stop_reading_or_go_away_without_a_word() {
    let served = served(16);
    let mut stuck: Vec<_> = (0..3).map(|_| served.viewer()).collect();
    let gone = served.viewer();
    let mut viewers: Vec<_> = (0..10).map(|_| served.viewer()).collect();
    for viewer in viewers.iter_mut().chain(&mut stuck) {
        assert!(next(viewer).contains("hello"));
    }
    // So much that no buffer of the system has room for it: who reads nothing is behind.
    let rows = |at: u32| {
        let row = move |part: u32| {
            let mut row = vec![Some(f64::from(at) + 0.123_45); 12];
            row[0] = Some(f64::from(part));
            row
        };
        (0..200).map(row).collect::<Vec<_>>()
    };
    drop(gone);
    let readers: Vec<_> = viewers
        .into_iter()
        .map(|mut viewer| {
            std::thread::spawn(move || {
                loop {
                    let told = next(&mut viewer);
                    if told.contains("the last word") {
                        return;
                    }
                }
            })
        })
        .collect();
    for at in 0..700_u32 {
        let words = match at {
            699 => "the last word".to_owned(),
            _ => format!("word {at}"),
        };
        let step = scene::track::SceneStep {
            at_ns: at.into(),
            view: None,
            moved: rows(at),
            said: Some(scene::Said {
                words,
                ..scene::Said::default()
            }),
        };
        assert!(served.hub.showed("arm", step).is_some());
    }
    for reader in readers {
        reader.join().unwrap();
    }
    // One who was stuck and reads again is told the whole as it is now.
    let late = stuck.last_mut().unwrap();
    while !next(late).contains("the last word") {}
}
