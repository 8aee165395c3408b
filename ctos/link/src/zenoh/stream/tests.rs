use proptest::prelude::*;
use tokio::io::{AsyncReadExt, AsyncWriteExt};

use super::*;

/// One end without a network.
struct Lone {
    shared: Arc<Shared>,
    user: Stream,
    chunks: mpsc::UnboundedReceiver<Chunk>,
    sent: u64,
}

impl Lone {
    /// An end whose other one listens. It lives in a runtime.
    fn new() -> Self {
        let lone = Self::unheard();
        lone.shared.listened_to(true);
        lone
    }

    fn unheard() -> Self {
        let (shared, arrived) = Shared::new();
        let (user, other) = user_end(arrived);
        let (published, chunks) = mpsc::unbounded_channel();
        let carried = shared.clone();
        tokio::spawn(async move { carried.carry(other, published).await });
        Self {
            shared,
            user,
            chunks,
            sent: 0,
        }
    }

    /// The next chunk as it is published; `None` when there will be none.
    async fn next(&mut self) -> Option<Vec<u8>> {
        let chunk = self.chunks.recv().await?;
        self.sent += 1;
        Some(encoded(self.sent - 1, &chunk).unwrap())
    }

    fn broken(&self) -> Option<Broken> {
        match &*self.shared.state.borrow() {
            State::Broken(broken) => Some(broken.clone()),
            _ => None,
        }
    }
}

/// A step of everything that can go on.
async fn turn() {
    for _ in 0..100 {
        tokio::task::yield_now().await;
    }
}

fn run<T>(test: impl Future<Output = T>) -> T {
    let mut runtime = tokio::runtime::Builder::new_current_thread();
    runtime.enable_all().build().unwrap().block_on(test)
}

fn data(bytes: &[u8]) -> Chunk {
    Chunk::Data(Bytes::copy_from_slice(bytes))
}

fn size(chunk: &Chunk) -> usize {
    match chunk {
        Chunk::Data(data) => data.len(),
        _ => 0,
    }
}

proptest! {
    #[test]
    fn bytes_arrive_whole_and_in_order_however_they_are_cut_and_read(
        there in prop::collection::vec(any::<u8>(), 0..3000),
        repeat in 1..600_usize,
        write in 1..200_000_usize,
        read in 1..200_000_usize,
    ) {
        let bytes = there.repeat(repeat);
        let sent = bytes.clone();
        let (got, ends) = run(async move {
            let (a, b) = (Lone::new(), Lone::new());
            let (mut writer, mut reader) = (a.user, b.user);
            let (to_a, to_b) = (a.shared.clone(), b.shared.clone());
            tokio::spawn(async move {
                for part in sent.chunks(write) {
                    writer.write_all(part).await.unwrap();
                }
            });
            let reading = tokio::spawn(async move {
                let (mut got, mut part) = (Vec::new(), vec![0; read]);
                loop {
                    match reader.read(&mut part).await.unwrap() {
                        0 => return got,
                        count => got.extend_from_slice(&part[..count]),
                    }
                }
            });
            // Both end by themselves once everything has been read.
            let carried = |mut chunks: mpsc::UnboundedReceiver<Chunk>, to: Arc<Shared>| async move {
                let mut number = 0;
                while let Some(chunk) = chunks.recv().await {
                    to.arrive(&encoded(number, &chunk).unwrap());
                    number += 1;
                    assert!(lock(&to.arrivals).unread <= WINDOW);
                }
            };
            tokio::join!(carried(a.chunks, to_b), carried(b.chunks, to_a));
            let broken = |shared: &Shared| matches!(*shared.state.borrow(), State::Broken(_));
            (reading.await.unwrap(), (broken(&a.shared), broken(&b.shared)))
        });
        prop_assert!(got == bytes);
        prop_assert_eq!(ends, (false, false));
    }

    #[test]
    fn rubbish_breaks_the_stream_and_never_panics(chunks in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..40), 1..20)) {
        run(async {
            let mut end = Lone::new();
            for chunk in &chunks {
                end.shared.arrive(chunk);
            }
            turn().await;
            if end.broken().is_some() {
                let mut into = Vec::new();
                end.user.read_to_end(&mut into).await.unwrap();
            }
        });
    }
}

#[test]
fn what_is_lost_or_doubled_is_noticed_and_what_came_before_is_read() {
    for (skip, again) in [(1, 0), (0, 1)] {
        run(async {
            let (mut a, mut b) = (Lone::new(), Lone::new());
            let mut chunks = Vec::new();
            for text in ["one", "two", "three"] {
                a.user.write_all(text.as_bytes()).await.unwrap();
                chunks.push(a.next().await.unwrap());
            }
            b.shared.arrive(&chunks[0]);
            for _ in 0..again {
                b.shared.arrive(&chunks[0]);
            }
            if skip == 0 {
                b.shared.arrive(&chunks[1]);
            }
            b.shared.arrive(&chunks[2]);
            let mut got = Vec::new();
            b.user.read_to_end(&mut got).await.unwrap();
            assert_eq!(got, b"one");
            assert!(matches!(b.broken(), Some(Broken::Gap { .. })));
            turn().await;
            assert!(b.user.write_all(b"more").await.is_err());
        });
    }
}

#[test]
fn a_reader_that_stands_still_stops_the_sender_and_not_more() {
    run(async {
        let (mut a, mut b) = (Lone::new(), Lone::new());
        let mut writer = a.user;
        let writing = tokio::spawn(async move {
            let part = vec![7; CHUNK];
            while writer.write_all(&part).await.is_ok() {}
        });
        let (mut carried, mut number) = (0, 0);
        turn().await;
        while let Ok(chunk) = a.chunks.try_recv() {
            carried += size(&chunk);
            b.shared.arrive(&encoded(number, &chunk).unwrap());
            number += 1;
            turn().await;
        }
        assert!(carried <= WINDOW && WINDOW - carried < CHUNK, "{carried}");
        assert!(b.broken().is_none() && !writing.is_finished());
        // Half of it is read: so much more may come.
        let mut got = vec![0; WINDOW / 2];
        b.user.read_exact(&mut got).await.unwrap();
        while let Ok(chunk) = b.chunks.try_recv() {
            b.sent += 1;
            a.shared.arrive(&encoded(b.sent - 1, &chunk).unwrap());
        }
        assert!(a.chunks.recv().await.is_some());
        writing.abort();
    });
}

#[test]
fn who_sends_more_than_it_may_or_claims_what_was_never_sent_is_cut_off() {
    run(async {
        let end = Lone::new();
        let whole = encoded(0, &data(&vec![0; WINDOW])).unwrap();
        end.shared.arrive(&whole);
        assert!(end.broken().is_none());
        end.shared.arrive(&encoded(1, &data(b"!")).unwrap());
        assert_eq!(end.broken(), Some(Broken::Credit));
        let end = Lone::new();
        end.shared.arrive(&encoded(0, &Chunk::Read(1)).unwrap());
        assert_eq!(end.broken(), Some(Broken::Acknowledged));
    });
}

#[test]
fn nothing_is_sent_before_the_other_end_listens_and_all_ends_when_it_stops() {
    run(async {
        let mut end = Lone::unheard();
        end.user.write_all(b"early").await.unwrap();
        end.shared.listened_to(false);
        turn().await;
        assert!(end.chunks.try_recv().is_err());
        end.shared.listened_to(true);
        assert!(end.next().await.is_some());
        end.shared.listened_to(false);
        assert_eq!(end.broken(), Some(Broken::Gone));
        drop(std::mem::replace(
            &mut end.user,
            Box::new(tokio::io::empty()),
        ));
        while end.next().await.is_some() {}
    });
}

#[test]
fn what_comes_to_a_user_who_is_gone_counts_as_read() {
    run(async {
        let (mut a, mut b) = (Lone::new(), Lone::new());
        b.user.write_all(b"not read yet").await.unwrap();
        assert!(b.next().await.is_some());
        drop(std::mem::replace(&mut b.user, Box::new(tokio::io::empty())));
        for number in 0..3 {
            a.user.write_all(&vec![7; CHUNK]).await.unwrap();
            assert_eq!(a.sent, number);
            let sent = a.next().await.unwrap();
            b.shared.arrive(&sent);
        }
        // The last chunk, then what was read.
        let mut read = 0;
        while read == 0 {
            if let Chunk::Read(count) = b.chunks.recv().await.unwrap() {
                read += count;
            }
        }
        assert!(read >= TELL, "{read}");
    });
}
