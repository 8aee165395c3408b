//! Streams over real zenoh networks of this process: through a router, between peers, and with somebody
//! among them who should not be.

use std::net::TcpListener;

use tokio::io::{AsyncReadExt, AsyncWriteExt};

use super::*;
use crate::config::load_texts;

/// A test that takes longer hangs; none takes a fraction of it.
const WATCHDOG: Duration = Duration::from_secs(60);

fn run<T>(test: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build();
    let test = async { tokio::time::timeout(WATCHDOG, test).await.unwrap() };
    runtime.unwrap().block_on(test)
}

/// A port that nobody has at the moment.
fn free_port() -> u16 {
    let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
    listener.local_addr().unwrap().port()
}

/// A process of the app `name`, whose boot is the router at `port`.
async fn join(name: &str, port: u16, is_boot: bool) -> Arc<Fabric> {
    let text = format!(
        "[app]\nname = {name:?}\n[zenoh]\nmode = \"router\"\nlisten = [\"tcp/127.0.0.1:{port}\"]\n[chassis.a]\n[task.t]\nhandler = \"h\"\non = \"a\"\n"
    );
    let app = load_texts(&[("app.toml", &text)], &[], &[]);
    let app = app.map_err(|findings| findings.to_string()).unwrap();
    Fabric::join(&app, is_boot).await.unwrap().unwrap()
}

/// The boot of an app, which listens as `boot`, and a chassis of it.
async fn two() -> (Arc<Fabric>, Listener, Arc<Fabric>) {
    let port = free_port();
    let boot = join("cell", port, true).await;
    let listener = boot.listen("boot").await.unwrap();
    let chassis = join("cell", port, false).await;
    (boot, listener, chassis)
}

async fn accept(listener: &Listener) -> Stream {
    listener.accept().await.unwrap().answer().await.unwrap()
}

async fn connected(from: &Fabric, to: &Listener) -> (Stream, Stream) {
    let (called, caller) = tokio::join!(from.connect(to.key()), accept(to));
    (called.unwrap(), caller)
}

#[test]
fn bytes_cross_in_both_directions_however_many_and_the_end_is_seen() {
    run(async {
        let (boot, listener, chassis) = two().await;
        let (mut one, mut other) = connected(&chassis, &listener).await;
        for number in 0..200_u32 {
            one.write_u32(number).await.unwrap();
            assert_eq!(other.read_u32().await.unwrap(), number);
            other.write_u32(number + 1).await.unwrap();
            assert_eq!(one.read_u32().await.unwrap(), number + 1);
        }
        let bytes: Vec<u8> = (0..5_000_000_u32)
            .map(|index| (index % 251) as u8)
            .collect();
        let write = async {
            one.write_all(&bytes).await.unwrap();
            drop(one);
            chassis.close().await;
        };
        let mut read = Vec::new();
        let ((), count) = tokio::join!(write, other.read_to_end(&mut read));
        assert_eq!(count.unwrap(), bytes.len());
        assert!(read == bytes);
        boot.close().await;
    });
}

#[test]
fn a_reader_that_stands_still_delays_no_other_stream() {
    run(async {
        let (_boot, listener, chassis) = two().await;
        let (mut stuck, _unread) = connected(&chassis, &listener).await;
        let (mut one, mut other) = connected(&chassis, &listener).await;
        // As much as is taken without anybody reading.
        let fill = async {
            let part = vec![0; 64 * 1024];
            while stuck.write_all(&part).await.is_ok() {}
        };
        let others = async {
            for number in 0..100_u32 {
                one.write_u32(number).await.unwrap();
                assert_eq!(other.read_u32().await.unwrap(), number);
            }
        };
        tokio::select! {
            () = fill => panic!("somebody has read it"),
            () = others => {}
        }
    });
}

#[test]
fn an_end_that_leaves_the_network_is_missed_at_once() {
    run(async {
        let (_boot, listener, chassis) = two().await;
        let (_one, mut other) = connected(&chassis, &listener).await;
        // As when its process ends: nothing is said any more.
        let membership = chassis.membership.clone();
        let closed = on_thread(move || membership.session().unwrap().close().wait().is_ok());
        assert!(closed.await.unwrap());
        let mut rest = Vec::new();
        let _ = other.read_to_end(&mut rest).await;
        assert!(rest.is_empty());
    });
}

#[test]
fn apps_do_not_meet_even_with_one_router() {
    run(async {
        let port = free_port();
        let boot = join("cell", port, true).await;
        let listener = boot.listen("a").await.unwrap();
        for other in ["cell2", "cel", "ce*", "cell/a", "x"] {
            let stranger = join(other, port, false).await;
            let error = stranger.connect(listener.key()).await.err().unwrap();
            assert_eq!(
                error.kind(),
                io::ErrorKind::InvalidInput,
                "{other}: {error}"
            );
        }
        let chassis = join("cell", port, false).await;
        for key in [
            "ctos/cell/**",
            "ctos/cell/*",
            "ctos/cell//a",
            "ctos/cell",
            "ctos/cellar/a",
        ] {
            assert!(chassis.connect(key).await.is_err(), "{key}");
        }
    });
}

#[test]
fn a_call_waits_for_who_is_not_there_yet_and_ends_with_its_caller() {
    run(async {
        let (_boot, listener, chassis) = two().await;
        let nobody = format!("{}x", listener.key());
        let call = tokio::time::timeout(Duration::from_millis(200), chassis.connect(&nobody));
        assert!(call.await.is_err());
        // The thread of the call has ended as well, and with it what keeps the network from being left.
        chassis.close().await;
        assert!(chassis.connect(listener.key()).await.is_err());
    });
}

#[test]
fn rubbish_of_a_stranger_breaks_one_stream_and_not_the_next() {
    run(async {
        let port = free_port();
        let boot = join("cell", port, true).await;
        let listener = boot.listen("boot").await.unwrap();
        let (chassis, stranger) = (
            join("cell", port, false).await,
            join("cell", port, false).await,
        );
        let (mut one, mut other) = connected(&chassis, &listener).await;
        one.write_u8(1).await.unwrap();
        assert_eq!(other.read_u8().await.unwrap(), 1);
        let membership = stranger.membership.clone();
        let shouted = on_thread(move || {
            let session = membership.session().unwrap();
            session.put("ctos/cell/**", "rubbish").wait().unwrap();
            // A call without a stream's id is refused, and nobody else is.
            let replies = session.get("ctos/cell/*/call").payload("../x").wait();
            replies
                .unwrap()
                .recv()
                .is_ok_and(|reply| reply.result().is_ok())
        });
        let (answered, refused) = tokio::join!(shouted, async {
            listener.accept().await.unwrap().answer().await.is_err()
        });
        assert!(!answered.unwrap() && refused);
        let mut rest = Vec::new();
        let _ = other.read_to_end(&mut rest).await;
        assert!(rest.is_empty());
        // The rubbish may reach the chassis later than the boot, and then breaks the next stream there too.
        let mut carried = false;
        for _ in 0..2 {
            let (mut one, mut other) = connected(&chassis, &listener).await;
            let byte = async {
                one.write_u8(2).await?;
                tokio::select! {
                    byte = other.read_u8() => byte,
                    broken = one.read_u8() => broken,
                }
            };
            carried = carried || byte.await.is_ok_and(|byte| byte == 2);
        }
        assert!(carried, "rubbish of one time breaks every stream");
    });
}

#[test]
fn a_router_that_is_not_there_is_an_error_and_no_hang() {
    run(async {
        let text = format!(
            "[app]\nphase_timeout_s = 0.3\n[zenoh]\nmode = \"client\"\nconnect = [\"tcp/127.0.0.1:{}\"]\n[chassis.a]\n[task.t]\nhandler = \"h\"\non = \"a\"\n",
            free_port()
        );
        let app = load_texts(&[("app.toml", &text)], &[], &[]).unwrap();
        assert!(Fabric::join(&app, false).await.is_err());
    });
}

#[test]
fn different_names_make_different_parts_of_keys() {
    assert_eq!(key_part("cell_1-a.b"), "cell_1-a.b");
    assert_eq!(key_part("a/b *"), "a%2fb%20%2a");
    assert_ne!(key_part("a%2f"), key_part("a/"));
    assert!(is_plain_key(&format!("ctos/{}/x", key_part("*?#$/\u{e4}"))));
}
