//! Meshes of one process that join over real sockets, and strangers, impostors and rubbish among them.

use std::net::SocketAddr;

use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::{TcpListener, TcpStream},
};

use super::*;
use crate::doors::{NO_PAGE, STRANGERS};
use ctos_config::load_texts;
use ctos_core::{envelope::Message, registry::Registry, tap::WaitFor};
use ctos_link::{
    handshake::{Answer, GREETING, Greeting, Hello, greet, hear},
    security::{Role, make_key},
    transport::{Stream, connect},
};
use ctos_message::{ChassisNumber, Tid, fault::Fault};
use ctos_time::Clock;

#[cfg(feature = "zenoh")]
mod zenoh;

/// A test that takes longer hangs; none takes a fraction of it.
const WATCHDOG: Duration = Duration::from_secs(60);

fn run<T>(test: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build();
    let test = async { tokio::time::timeout(WATCHDOG, test).await.unwrap() };
    runtime.unwrap().block_on(test)
}

fn token() -> Token {
    Token("the secret of this run".to_owned())
}

/// Chassis number `index` of an app of three besides the boot.
fn chassis(index: ChassisNumber, sets: &[&str]) -> Arc<Chassis> {
    let text = "[chassis.a]\n[chassis.b]\n[chassis.c]\n[task.one]\nhandler = \"none\"\non = \"a\"";
    let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
    let app = load_texts(&[("mesh.toml", text)], &sets, &[]);
    let app = app.map_err(|findings| findings.to_string()).unwrap();
    Chassis::new(
        index,
        Arc::new(app),
        Arc::new(Registry::new()),
        Clock::real(),
    )
}

/// A chassis with its mesh.
struct Node {
    chassis: Arc<Chassis>,
    mesh: Mesh,
}

impl Node {
    async fn start(index: ChassisNumber, incarnation: u32, sets: &[&str]) -> Self {
        let chassis = chassis(index, sets);
        let token = token();
        let who = Identification { token, incarnation };
        let mesh = Mesh::start(&chassis, who).await.unwrap();
        Self { chassis, mesh }
    }

    /// The boot, which expects so many chassis.
    async fn boot(count: ChassisNumber, sets: &[&str]) -> Self {
        let boot = Self::start(0, 1, sets).await;
        for index in 1..=count {
            boot.mesh.expect(index, 1);
        }
        boot
    }

    fn address(&self) -> Address {
        self.mesh.addresses()[0].clone()
    }

    /// The next event that is not the arrival of a link.
    async fn event(&mut self) -> MeshEvent {
        loop {
            match self.mesh.next().await {
                MeshEvent::Up { .. } => {}
                other => return other,
            }
        }
    }

    /// Waits until a chassis is connected to this one.
    async fn linked(&mut self, chassis: ChassisNumber) {
        while !self.chassis.is_linked(chassis) {
            self.mesh.next().await;
        }
    }

    /// Waits until all of `others` have joined.
    async fn joined_by(&mut self, others: &[ChassisNumber]) {
        let mut missing = others.to_vec();
        while !missing.is_empty() {
            match self.event().await {
                MeshEvent::Joined { chassis, .. } => missing.retain(|other| *other != chassis),
                other => panic!("{other:?}"),
            }
        }
    }

    async fn went_down(&mut self, chassis: ChassisNumber) -> DownReason {
        loop {
            if let MeshEvent::Down {
                chassis: gone,
                reason,
                ..
            } = self.event().await
                && gone == chassis
            {
                return reason;
            }
        }
    }
}

/// A boot and `count` chassis that have joined it.
async fn app(count: ChassisNumber, sets: &[&str]) -> (Node, Vec<Node>) {
    let mut boot = Node::boot(count, sets).await;
    let mut others = Vec::new();
    for index in 1..=count {
        let node = Node::start(index, 1, sets).await;
        node.mesh.join(&boot.address());
        others.push(node);
    }
    boot.joined_by(&(1..=count).collect::<Vec<_>>()).await;
    for node in &mut others {
        node.joined_by(&[node.chassis.index()]).await;
    }
    (boot, others)
}

/// A call from the first chassis to a task that the other one has not. That the error comes back shows
/// that the link carries both ways.
async fn asks(from: &Arc<Chassis>, to: ChassisNumber) -> Fault {
    let (to, sender) = (Tid::new(to, 1, 0), Tid::new(from.index(), 0, 0));
    let message = Message::request(to, sender, 1, 7_u8);
    from.dispatch(message, WaitFor::Reply).await.unwrap_err()
}

#[test]
fn all_reach_all_by_every_kind_of_link() {
    for same_host in ["same_host=shm", "same_host=unix", "same_host=tcp"] {
        run(async {
            let (boot, others) = app(3, &[same_host]).await;
            for from in others.iter().chain([&boot]) {
                for to in from.chassis.others() {
                    assert_eq!(
                        asks(&from.chassis, to).await,
                        Fault::UnknownTask,
                        "{same_host}"
                    );
                }
            }
        });
    }
}

#[test]
fn two_are_linked_when_one_of_them_first_needs_the_other_whoever_that_is() {
    for (from, to) in [(0, 2), (2, 0)] {
        run(async {
            let (_boot, others) = app(3, &[]).await;
            let linked = |one: usize, other: usize| {
                let number = others[other].chassis.index();
                others[one].chassis.is_linked(number)
            };
            assert!(!linked(from, to) && !linked(to, from));
            let fault = asks(&others[from].chassis, others[to].chassis.index()).await;
            assert_eq!(fault, Fault::UnknownTask);
            assert!(linked(from, to) && linked(to, from));
            assert!(!linked(from, 1) && !linked(1, from) && !linked(to, 1));
        });
    }
}

#[test]
fn two_that_need_each_other_at_the_same_time_have_one_stream() {
    run(async {
        let (_boot, others) = app(2, &["same_host=unix"]).await;
        let [a, b] = [&others[0].chassis, &others[1].chassis];
        let (one, other) = tokio::join!(asks(a, 2), asks(b, 1));
        assert_eq!([one, other], [Fault::UnknownTask, Fault::UnknownTask]);
        for (chassis, peer) in [(a, "b"), (b, "a")] {
            let counts = chassis.link_counts();
            let (_, counts) = counts.iter().find(|(name, _)| name == peer).unwrap();
            assert_eq!(counts.streams, 1, "{peer}");
        }
    });
}

#[test]
fn who_is_gone_when_it_is_first_needed_is_down_at_once() {
    // Of the two, the second one calls the first.
    for (stays, goes) in [(0, 1), (1, 0)] {
        run(async {
            let (mut boot, mut others) = app(2, &["peer_timeout_s=50"]).await;
            let gone = goes as ChassisNumber + 1;
            others[goes].chassis.drop_links();
            others[goes].mesh.close().await;
            boot.went_down(gone).await;
            let fault = asks(&others[stays].chassis, gone).await;
            let chassis = ["a", "b"][goes].to_owned();
            assert_eq!(fault, Fault::PeerDown { chassis });
            assert!(!others[stays].chassis.reach(gone));
        });
    }
}

#[test]
fn nobody_is_told_that_another_one_has_left() {
    run(async {
        let (mut boot, mut others) = app(3, &["same_host=unix"]).await;
        while let Some(mut last) = others.pop() {
            last.mesh.close().await;
            boot.went_down(last.chassis.index()).await;
            boot.mesh.inner.changed();
            for other in &others {
                // What it was told before has come with this.
                asks(&boot.chassis, other.chassis.index()).await;
            }
            let joins = |event: &MeshEvent| matches!(event, MeshEvent::Joined { .. });
            let told = others.iter_mut().any(|other| {
                let events = std::iter::from_fn(|| other.mesh.events.try_recv().ok());
                events.filter(joins).count() > 0
            });
            assert!(!told);
        }
    });
}

#[test]
fn strangers_delay_nobody_and_are_counted() {
    run(async {
        let mut boot = Node::boot(1, &["same_host=tcp"]).await;
        let Address::Tcp(address) = boot.address() else {
            panic!("not TCP")
        };
        let two_gibibytes = [b"ctos\0\0\0\x02", &(1_u32 << 31).to_le_bytes()[..]].concat();
        let mut lines = Vec::new();
        for says in [
            &b""[..],
            b"GET / HTTP/1.1\r\n\r\n",
            &two_gibibytes,
            b"ctos\0\0\0\x01more",
        ] {
            let mut stream = TcpStream::connect(address).await.unwrap();
            stream.write_all(says).await.unwrap();
            lines.push(stream);
        }
        // Knows everything but the secret.
        let mut guesses = connect(&boot.address(), None, None).await.unwrap().0;
        let greeting = Greeting::Hello {
            token: Token("guessed".to_owned()),
            hello: hello(1, 1),
        };
        greet(&mut guesses, GREETING, &greeting).await.unwrap();
        assert!(hear::<Answer>(&mut guesses).await.is_err());
        // Knows the secret and calls itself what nobody is.
        for nobody in [0, 4, 200] {
            let mut stream = connect(&boot.address(), None, None).await.unwrap().0;
            say_hello(&mut stream, hello(nobody, 1)).await;
            assert!(hear::<Answer>(&mut stream).await.is_err());
        }
        let a = Node::start(1, 1, &["same_host=tcp"]).await;
        a.mesh.join(&boot.address());
        boot.joined_by(&[1]).await;
        // All but the one who still says nothing, and the browser, which has not hung up.
        assert_eq!(boot.mesh.refused(), 6);
    });
}

#[test]
fn idle_strangers_keep_no_member_out() {
    run(async {
        let mut boot = Node::boot(1, &["same_host=tcp"]).await;
        let Address::Tcp(address) = boot.address() else {
            panic!("not TCP")
        };
        let mut idle = Vec::new();
        for _ in 0..STRANGERS + 6 {
            idle.push(TcpStream::connect(address).await.unwrap());
        }
        let a = Node::start(1, 1, &["same_host=tcp"]).await;
        a.mesh.join(&boot.address());
        boot.joined_by(&[1]).await;
        // The mesh did not wait for those who said nothing: the longest silent of them went.
        assert!(boot.mesh.refused() >= 6);
        assert!(boot.mesh.refused() < STRANGERS as u64);
    });
}

#[test]
fn a_browser_at_the_door_of_a_mesh_is_told_that_it_is_no_page() {
    run(async {
        let boot = Node::boot(1, &["same_host=tcp"]).await;
        let Address::Tcp(address) = boot.address() else {
            panic!("not TCP")
        };
        let mut browser = TcpStream::connect(address).await.unwrap();
        let post = b"POST / HTTP/1.1\r\nHost: localhost\r\n\r\nctos\0\0\0\x05";
        browser.write_all(post).await.unwrap();
        browser.shutdown().await.unwrap();
        let mut answer = String::new();
        browser.read_to_string(&mut answer).await.unwrap();
        assert_eq!(answer, NO_PAGE);
    });
}

fn hello(chassis: ChassisNumber, incarnation: u32) -> Hello {
    Hello {
        member: Member {
            chassis,
            incarnation,
            process: Process {
                host: "elsewhere".to_owned(),
                pid: 1,
            },
            listen: Vec::new(),
        },
        received: 0,
        shared: false,
    }
}

async fn say_hello(stream: &mut Stream, hello: Hello) {
    let token = token();
    greet(stream, GREETING, &Greeting::Hello { token, hello })
        .await
        .unwrap();
}

/// Calls `node` as chassis 1 and shakes hands; what comes then is the test's.
async fn impostor(node: &Node) -> Stream {
    let mut stream = connect(&node.address(), None, None).await.unwrap().0;
    say_hello(&mut stream, hello(1, 1)).await;
    let answer = hear::<Answer>(&mut stream).await.unwrap();
    assert!(matches!(answer, Answer::Welcome { .. }));
    stream
}

#[test]
fn a_peer_that_announces_two_gibibytes_or_talks_rubbish_loses_its_own_link_only() {
    let two_gibibytes = [&(1_u32 << 31).to_le_bytes()[..], &[1; 17]].concat();
    let unknown_kind = [&17_u32.to_le_bytes()[..], &[99; 17]].concat();
    for rubbish in [two_gibibytes, unknown_kind] {
        run(async {
            let mut boot = Node::boot(2, &["same_host=unix"]).await;
            let b = Node::start(2, 1, &["same_host=unix"]).await;
            b.mesh.join(&boot.address());
            boot.linked(2).await;
            let mut stream = impostor(&boot).await;
            let waits = tokio::spawn({
                let chassis = boot.chassis.clone();
                async move { asks(&chassis, 1).await }
            });
            stream.write_all(&rubbish).await.unwrap();
            let reason = boot.went_down(1).await;
            assert!(matches!(reason, DownReason::Rubbish(_)), "{reason}");
            let gone = Fault::PeerDown {
                chassis: "a".to_owned(),
            };
            assert_eq!(waits.await.unwrap(), gone);
            assert_eq!(asks(&boot.chassis, 2).await, Fault::UnknownTask);
            // The line is closed.
            while stream.read_u8().await.is_ok() {}
        });
    }
}

#[test]
fn a_peer_that_falls_silent_is_down_within_the_time_and_may_not_come_back() {
    run(async {
        let mut boot = Node::boot(1, &["same_host=unix", "peer_timeout_s=0.2"]).await;
        let _stays_on_the_line = impostor(&boot).await;
        let began = boot.chassis.clock.now();
        let reason = boot.went_down(1).await;
        assert_eq!(reason, DownReason::Silence(Duration::from_millis(200)));
        assert!(boot.chassis.clock.now().since(began) >= Duration::from_millis(150));
        let mut again = connect(&boot.address(), None, None).await.unwrap().0;
        say_hello(&mut again, hello(1, 1)).await;
        assert_eq!(hear::<Answer>(&mut again).await.unwrap(), Answer::GivenUp);
        // Its successor may.
        boot.mesh.expect(1, 2);
        let mut successor = connect(&boot.address(), None, None).await.unwrap().0;
        say_hello(&mut successor, hello(1, 2)).await;
        let answer = hear::<Answer>(&mut successor).await.unwrap();
        assert!(matches!(answer, Answer::Welcome { .. }));
    });
}

#[test]
fn a_chassis_that_was_given_up_is_told_so() {
    run(async {
        let mut boot = Node::boot(1, &[]).await;
        let mut a = Node::start(1, 1, &[]).await;
        // Its successor was there before it.
        boot.mesh.expect(1, 2);
        a.mesh.join(&boot.address());
        assert_eq!(a.went_down(0).await, DownReason::GivenUp);
        let successor = Node::start(1, 2, &[]).await;
        successor.mesh.join(&boot.address());
        boot.joined_by(&[1]).await;
    });
}

#[test]
fn a_chassis_that_was_started_again_joins_and_its_predecessors_link_goes_down_first() {
    run(async {
        let (mut boot, mut others) = app(3, &[]).await;
        boot.mesh.expect(2, 2);
        let successor = Node::start(2, 2, &[]).await;
        successor.mesh.join(&boot.address());
        // What the boot sees of chassis 2.
        let mut seen = Vec::new();
        while seen.last() != Some(&("joined", 2)) {
            match boot.mesh.next().await {
                MeshEvent::Up {
                    chassis: 2,
                    incarnation,
                } => seen.push(("up", incarnation)),
                MeshEvent::Down {
                    chassis: 2,
                    incarnation,
                    ..
                } => seen.push(("down", incarnation)),
                MeshEvent::Joined {
                    chassis: 2,
                    incarnation: 2,
                } => seen.push(("joined", 2)),
                _ => {}
            }
        }
        assert_eq!(seen, [("down", 1), ("up", 2), ("joined", 2)]);
        for other in [0, 1, 3] {
            assert_eq!(asks(&successor.chassis, other).await, Fault::UnknownTask);
        }
        assert_eq!(asks(&others[0].chassis, 2).await, Fault::UnknownTask);
        assert_eq!(others[1].went_down(0).await, DownReason::GivenUp);
    });
}

#[test]
fn a_goodbye_is_heard_by_all_that_are_linked_and_the_end_of_a_process_only_after_its_last_words() {
    run(async {
        let (mut boot, mut others) = app(2, &["same_host=unix"]).await;
        let mut b = others.pop().unwrap();
        asks(&others[0].chassis, 2).await;
        b.chassis.drop_links();
        b.mesh.close().await;
        assert_eq!(boot.went_down(2).await, DownReason::Bye);
        assert_eq!(others[0].went_down(2).await, DownReason::Bye);
        let stream = impostor_of(&boot, 3).await;
        boot.linked(3).await;
        let session = boot.mesh.inner.session(3).unwrap();
        session.event(Event::PeerEnded, DownReason::Ended);
        assert!(boot.chassis.is_linked(3));
        drop(stream);
        assert_eq!(boot.went_down(3).await, DownReason::Ended);
    });
}

async fn impostor_of(node: &Node, chassis: ChassisNumber) -> Stream {
    let mut stream = connect(&node.address(), None, None).await.unwrap().0;
    say_hello(&mut stream, hello(chassis, 1)).await;
    hear::<Answer>(&mut stream).await.unwrap();
    stream
}

/// Passes bytes on between callers and `to`, and hangs up on both after some thousand of them.
async fn cutting_proxy(listener: TcpListener, to: SocketAddr) {
    let mut limit = 700;
    loop {
        let (mut near, _) = listener.accept().await.unwrap();
        let Ok(mut far) = TcpStream::connect(to).await else {
            return;
        };
        limit += 311;
        let mut left = limit;
        let mut bytes = ([0; 97], [0; 97]);
        while left > 0 {
            let passed = tokio::select! {
                read = near.read(&mut bytes.0) => match read {
                    Ok(count) if count > 0 => far.write_all(&bytes.0[..count]).await.map(|()| count),
                    _ => break,
                },
                read = far.read(&mut bytes.1) => match read {
                    Ok(count) if count > 0 => near.write_all(&bytes.1[..count]).await.map(|()| count),
                    _ => break,
                },
            };
            let Ok(count) = passed else { break };
            left = usize::saturating_sub(left, count);
        }
    }
}

#[test]
fn a_link_through_a_proxy_that_hangs_up_again_and_again_answers_every_call_in_order() {
    run(async {
        let mut boot = Node::boot(1, &["same_host=tcp"]).await;
        let Address::Tcp(to) = boot.address() else {
            panic!("not TCP")
        };
        let listener = TcpListener::bind(("127.0.0.1", 0)).await.unwrap();
        let proxy = Address::Tcp(listener.local_addr().unwrap());
        tokio::spawn(cutting_proxy(listener, to));
        let mut a = Node::start(1, 1, &["same_host=tcp"]).await;
        a.mesh.join(&proxy);
        boot.joined_by(&[1]).await;
        a.joined_by(&[1]).await;
        for _ in 0..100 {
            assert_eq!(asks(&a.chassis, 0).await, Fault::UnknownTask);
            assert_eq!(asks(&boot.chassis, 1).await, Fault::UnknownTask);
        }
        let (peer, counts) = a.chassis.link_counts().remove(0);
        assert_eq!(peer, "boot");
        assert!(counts.streams > 5, "only {} streams", counts.streams);
    });
}

#[test]
fn a_cut_shorter_than_the_time_is_repaired_and_a_longer_one_makes_the_peer_down() {
    run(async {
        let sets = ["peer_timeout_s=1", "injure.cut=[\"a:boot@0s+0.1s\"]"];
        let (boot, others) = app(1, &sets).await;
        assert_eq!(asks(&others[0].chassis, 0).await, Fault::UnknownTask);
        assert_eq!(asks(&boot.chassis, 1).await, Fault::UnknownTask);
    });
    run(async {
        let sets = ["peer_timeout_s=0.3", "injure.cut=[\"a:boot@2s\"]"];
        let (mut boot, mut others) = app(1, &sets).await;
        let reason = DownReason::Silence(Duration::from_millis(300));
        assert_eq!(boot.went_down(1).await, reason);
        assert_eq!(others[0].went_down(0).await, reason);
    });
}

#[test]
fn lost_and_late_packets_are_repaired() {
    run(async {
        let sets = ["injure.drop=0.3", "injure.delay=1ms..3ms"];
        let (boot, others) = app(2, &sets).await;
        for _ in 0..20 {
            assert_eq!(asks(&others[0].chassis, 2).await, Fault::UnknownTask);
            assert_eq!(asks(&boot.chassis, 1).await, Fault::UnknownTask);
        }
    });
}

#[test]
fn an_address_that_is_taken_or_not_of_this_host_is_said() {
    run(async {
        let keys = tempfile::tempdir().unwrap();
        make_key(&keys.path().join("a"), Role::Boot).unwrap();
        let keys = keys.path().display();
        let security = format!("security={{key=\"{keys}/a\",authority=\"{keys}/ca.pem\"}}");
        let listener = TcpListener::bind(("127.0.0.1", 0)).await.unwrap();
        for address in [
            listener.local_addr().unwrap().to_string(),
            "192.0.2.1:7000".to_owned(),
        ] {
            let listen = format!("chassis.a.listen=\"{address}\"");
            let chassis = chassis(1, &[&listen, &security]);
            let who = Identification {
                token: token(),
                incarnation: 1,
            };
            let error = Mesh::start(&chassis, who).await.err().unwrap().to_string();
            assert!(error.contains(&address), "{error}");
        }
    });
}

#[test]
fn a_boot_that_nobody_answers_for_is_down_and_not_waited_for() {
    run(async {
        let nobody = TcpListener::bind(("127.0.0.1", 0)).await.unwrap();
        let refuses = Address::Tcp(nobody.local_addr().unwrap());
        drop(nobody);
        let gone = Address::Unix("/nonexistent/boot.sock".into());
        for boot in [refuses, gone] {
            let mut a = Node::start(1, 1, &[]).await;
            a.mesh.join(&boot);
            let reason = a.went_down(0).await;
            assert!(matches!(reason, DownReason::Deserted(_)), "{reason}");
        }
        // A host that says nothing at all.
        let mute = TcpListener::bind(("127.0.0.1", 0)).await.unwrap();
        let mut a = Node::start(1, 1, &["peer_timeout_s=0.1"]).await;
        a.mesh.join(&Address::Tcp(mute.local_addr().unwrap()));
        let reason = a.went_down(0).await;
        assert_eq!(reason, DownReason::Silence(Duration::from_millis(100)));
    });
}

#[test]
fn with_keys_only_those_of_role_boot_become_chassis() {
    let folder = tempfile::tempdir().unwrap();
    for (name, role) in [("cell", Role::Boot), ("panel", Role::Control)] {
        make_key(&folder.path().join(name), role).unwrap();
    }
    let keys = folder.path().display();
    let with =
        |name: &str| format!("security={{key=\"{keys}/{name}\",authority=\"{keys}/ca.pem\"}}");
    run(async {
        let cell = with("cell");
        let sets = ["same_host=tcp", &cell, "peer_timeout_s=1"];
        let boot = Node::boot(1, &sets).await;
        let panel = with("panel");
        let mut pretends =
            Node::start(1, 1, &["same_host=tcp", &panel, "peer_timeout_s=0.3"]).await;
        pretends.mesh.join(&boot.address());
        pretends.went_down(0).await;
        assert!(boot.mesh.refused() > 0);
        // Without any key it is not even heard.
        let mut plain = connect(&boot.address(), None, None).await.unwrap().0;
        say_hello(&mut plain, hello(1, 1)).await;
        assert!(hear::<Answer>(&mut plain).await.is_err());
        let mut a = Node::start(1, 1, &sets).await;
        a.mesh.join(&boot.address());
        a.joined_by(&[1]).await;
        assert_eq!(asks(&a.chassis, 0).await, Fault::UnknownTask);
    });
}

#[test]
fn of_any_two_exactly_one_calls() {
    for ours in [(1, 1), (2, 1), (1, 2), (3, 7)] {
        for theirs in [(1, 1), (2, 1), (1, 2), (3, 7)] {
            assert_eq!(calls(ours, theirs) || calls(theirs, ours), ours != theirs);
            assert!(!(calls(ours, theirs) && calls(theirs, ours)));
        }
    }
}
