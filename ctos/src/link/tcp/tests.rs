//! Strangers at the door, and rubbish on a link, against the real listener and the real link.

use proptest::prelude::*;
use tokio::io::{AsyncReadExt, AsyncWriteExt};

use super::*;
use crate::{
    call::Fault,
    chassis::{Envelope, WaitFor},
    config::load_texts,
    message::{Data, Flags, Tid},
    registry::Registry,
    time::Clock,
};

/// A call that takes longer hangs; nothing here takes a fraction of it.
const WATCHDOG: Duration = Duration::from_secs(30);

fn run<T>(test: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    runtime.block_on(async { tokio::time::timeout(WATCHDOG, test).await.unwrap() })
}

fn token() -> Token {
    Token("the secret of this run".to_owned())
}

fn hello(token: Token) -> Handshake {
    Handshake::Hello {
        version: VERSION,
        token,
        chassis: 1,
        listen: None,
    }
}

async fn listener() -> (TcpListener, SocketAddr) {
    let listener = TcpListener::bind(("127.0.0.1", 0)).await.unwrap();
    let address = listener.local_addr().unwrap();
    (listener, address)
}

/// Lets strangers call first, then a chassis that belongs; it must be heard.
async fn heard_after(strangers: &[Vec<u8>]) -> u8 {
    let (listener, address) = listener().await;
    let mut silent = Vec::new();
    for bytes in strangers {
        let mut stream = TcpStream::connect(address).await.unwrap();
        stream.write_all(bytes).await.unwrap();
        // Stays on the line.
        silent.push(stream);
    }
    let mut chassis = Connection::new(TcpStream::connect(address).await.unwrap()).unwrap();
    chassis.tell(&hello(token())).await.unwrap();
    let mut heard = 0;
    let accept = |caller: Caller| {
        heard = caller.chassis;
        ControlFlow::Break(())
    };
    callers(&listener, &token(), accept).await.unwrap();
    heard
}

fn framed(handshake: &Handshake) -> Vec<u8> {
    let body = postcard::to_stdvec(handshake).unwrap();
    let length = u32::try_from(body.len()).unwrap();
    [&length.to_le_bytes(), body.as_slice()].concat()
}

#[test]
fn strangers_who_say_nothing_or_announce_two_gibibytes_delay_nobody() {
    let two_gibibytes = (1_u32 << 31).to_le_bytes().to_vec();
    let begun = [&1000_u32.to_le_bytes()[..], b"and then nothing"].concat();
    assert_eq!(run(heard_after(&[Vec::new(), two_gibibytes, begun])), 1);
}

#[test]
fn a_stranger_without_the_secret_is_neither_a_chassis_nor_able_to_refuse_the_boot() {
    let wrong = || Token("guessed".to_owned());
    let old = Handshake::Hello {
        version: VERSION + 1,
        token: token(),
        chassis: 2,
        listen: None,
    };
    let refused = Handshake::Refused {
        token: wrong(),
        reason: "because".to_owned(),
    };
    let strangers = [
        hello(wrong()),
        old,
        refused,
        Handshake::Go,
        Handshake::Ready,
    ];
    assert_eq!(run(heard_after(&strangers.each_ref().map(framed))), 1);
}

#[test]
fn a_chassis_that_belongs_and_cannot_start_is_heard() {
    let error = run(async {
        let (listener, address) = listener().await;
        let mut chassis = Connection::new(TcpStream::connect(address).await.unwrap()).unwrap();
        let refused = Handshake::Refused {
            token: token(),
            reason: "the port is taken".to_owned(),
        };
        chassis.tell(&refused).await.unwrap();
        callers(&listener, &token(), |_| ControlFlow::Continue(())).await
    });
    assert_eq!(error.unwrap_err().to_string(), "the port is taken");
}

#[test]
fn no_frame_before_the_handshake_makes_anybody_reserve_memory() {
    run(async {
        let (listener, address) = listener().await;
        let mut stranger = TcpStream::connect(address).await.unwrap();
        let length = u32::try_from(HANDSHAKE_LIMIT + 1).unwrap();
        stranger.write_all(&length.to_le_bytes()).await.unwrap();
        let (stream, _) = listener.accept().await.unwrap();
        let mut connection = Connection::new(stream).unwrap();
        assert!(matches!(
            connection.hear().await,
            Err(HandshakeError::Io(_))
        ));
    });
}

#[test]
fn secrets_are_not_shown() {
    let shown = format!("{:?}", hello(token()));
    assert!(!shown.contains("secret"), "{shown}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn whatever_strangers_say_the_boot_goes_on(
        strangers in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..64), 0..4)
    ) {
        prop_assert_eq!(run(heard_after(&strangers)), 1);
    }

    #[test]
    fn rubbish_on_a_link_ends_the_link_and_the_calls_that_wait_for_it(
        rubbish in proptest::collection::vec(any::<u8>(), 1..200)
    ) {
        let answer = run(rubbish_on_a_link(&rubbish));
        let gone = Fault::PeerDown { chassis: "a".to_owned() };
        prop_assert_eq!(answer.unwrap_err(), gone);
    }
}

fn chassis() -> Arc<Chassis> {
    let text = "[chassis.a]\n[task.one]\nhandler = \"none\"\non = \"a\"";
    let app = load_texts(&[("link.toml", text)], &[], &[]).unwrap();
    Chassis::new(0, Arc::new(app), Arc::new(Registry::new()), Clock::real())
}

/// A call over a link whose other end answers with rubbish and hangs up.
async fn rubbish_on_a_link(rubbish: &[u8]) -> Result<Data, Fault> {
    let (listener, address) = listener().await;
    let mut peer = TcpStream::connect(address).await.unwrap();
    let (stream, _) = listener.accept().await.unwrap();
    let chassis = chassis();
    let _writer = Connection::new(stream).unwrap().into_link(&chassis, 1);
    let envelope = Envelope {
        to: Tid::new(1, 1, 0),
        from: Tid::new(0, 0, 0),
        command: 1,
        flags: Flags::NONE,
        data: Data::of(7_u8),
        trace: 0,
        deadline: None,
    };
    let waiting = chassis.dispatch(envelope, WaitFor::Reply);
    peer.write_all(rubbish).await.unwrap();
    peer.shutdown().await.unwrap();
    let answer = waiting.await;
    // The request did go out.
    let mut length = [0; 4];
    peer.read_exact(&mut length).await.unwrap();
    answer
}
