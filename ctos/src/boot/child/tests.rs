//! A chassis that connects, between a boot that the test plays, strangers, and another chassis.

use std::time::Duration;

use tokio::io::AsyncWriteExt;

use super::*;
use crate::config::load_texts;

const WATCHDOG: Duration = Duration::from_secs(30);

fn token() -> Token {
    Token("the secret of this run".to_owned())
}

fn chassis() -> Arc<Chassis> {
    let text = "[chassis.a]\n[chassis.b]\n[task.one]\nhandler = \"none\"\non = \"a\"";
    let app = load_texts(&[("child.toml", text)], &[], &[]).unwrap();
    Chassis::new(1, Arc::new(app), Arc::new(Registry::new()), Clock::real())
}

fn hello(chassis: u8) -> Handshake {
    Handshake::Hello {
        version: VERSION,
        token: token(),
        chassis,
        listen: None,
    }
}

/// Lets chassis `a` connect while `others` plays everybody else.
fn run<Others: Future<Output = ()>>(
    others: impl FnOnce(TcpListener) -> Others,
) -> Result<(), ChildError> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    runtime.block_on(async {
        let listener = TcpListener::bind(("127.0.0.1", 0)).await.unwrap();
        let address = listener.local_addr().unwrap();
        let (chassis, token) = (chassis(), token());
        let both = futures_util::future::join(connect(&chassis, address, &token), others(listener));
        let (connected, ()) = tokio::time::timeout(WATCHDOG, both).await.unwrap();
        connected.map(|(writers, _)| {
            assert_eq!(writers.len(), 2);
            assert!(chassis.is_linked(0) && chassis.is_linked(2));
        })
    })
}

/// The boot's side up to the point at which the chassis waits for the others.
async fn introduced(listener: TcpListener) -> (Connection, SocketAddr) {
    let (stream, _) = listener.accept().await.unwrap();
    let mut boot = Connection::new(stream).unwrap();
    let Handshake::Hello {
        listen: Some(listen),
        ..
    } = boot.hear().await.unwrap()
    else {
        panic!("no hello");
    };
    let peers = Handshake::Peers(vec![(1, listen), (2, listen)]);
    boot.tell(&peers).await.unwrap();
    (boot, listen)
}

#[test]
fn a_stranger_on_the_line_keeps_no_chassis_from_connecting() {
    run(|listener| async move {
        let (mut boot, address) = introduced(listener).await;
        let _silent = TcpStream::connect(address).await.unwrap();
        let mut rude = TcpStream::connect(address).await.unwrap();
        rude.write_all(&[0xff; 64]).await.unwrap();
        let mut lost = Connection::new(TcpStream::connect(address).await.unwrap()).unwrap();
        // Knows the secret, but nobody expects a chassis 9.
        lost.tell(&hello(9)).await.unwrap();
        let mut other = Connection::new(TcpStream::connect(address).await.unwrap()).unwrap();
        other.tell(&hello(2)).await.unwrap();
        assert_eq!(boot.hear().await.unwrap(), Handshake::Ready);
        boot.tell(&Handshake::Go).await.unwrap();
    })
    .unwrap();
}

#[test]
fn a_chassis_whose_boot_dies_while_it_waits_for_the_others_ends() {
    let error = run(|listener| async move {
        let (boot, _) = introduced(listener).await;
        drop(boot);
    });
    let text = error.unwrap_err().to_string();
    assert!(text.contains("cannot connect to the boot"), "{text}");
}

#[test]
fn a_boot_that_talks_nonsense_is_an_error() {
    let error = run(|listener| async move {
        let (stream, _) = listener.accept().await.unwrap();
        let mut boot = Connection::new(stream).unwrap();
        boot.tell(&Handshake::Go).await.unwrap();
        let _ = boot.hear().await;
    });
    let text = error.unwrap_err().to_string();
    assert!(text.contains("where something else was expected"), "{text}");
}
