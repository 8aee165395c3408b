//! The pool in one process, where Miri can watch, and through a passed file.

use proptest::prelude::*;

use super::*;

/// Bytes of a small pool.
const SMALL: usize = 1 << 20;

/// A pool, the loans to one peer, and what that peer has of it.
fn pair() -> (Arc<Pool>, Lending, Arc<Foreign>) {
    let pool = private();
    let (lending, foreign) = lent_to_a_peer(&pool);
    (pool, lending, foreign)
}

/// A pool of this process alone.
pub(crate) fn private() -> Arc<Pool> {
    Pool::of(Memory::private(SMALL), None)
}

/// What joins a peer to a pool.
pub(crate) fn lent_to_a_peer(pool: &Arc<Pool>) -> (Lending, Arc<Foreign>) {
    let words = Words {
        memory: Arc::new(Memory::private(PAGE)),
        start: 0,
    };
    let (ours, theirs) = pipe_with(PipeFlags::NONBLOCK).unwrap();
    let lending = Lending::new(pool.clone(), words.clone(), ours);
    let foreign = Arc::new(Foreign {
        memory: pool.memory.clone(),
        words,
        _pipe: Some(theirs),
    });
    (lending, foreign)
}

/// Whether all of it is free.
pub(crate) fn is_free(pool: &Pool) -> bool {
    pool.sweep();
    pool.free() == whole()
}

fn block(pool: &Arc<Pool>, size: usize, fill: u8) -> Bytes {
    let mut block = pool.block(size).unwrap();
    block.fill(fill);
    Bytes::from_owner(block)
}

fn whole() -> BTreeMap<usize, usize> {
    BTreeMap::from([(0, SMALL)])
}

#[test]
fn what_is_made_in_the_pool_is_read_where_it_was_made_and_comes_back() {
    let (pool, mut lending, foreign) = pair();
    let made = block(&pool, 100_000, 7);
    let address = made.as_ptr();
    let place = lending.lend(&made).unwrap();
    let there = foreign.borrow(place).unwrap();
    drop(made);
    assert_eq!(there.as_ptr(), address);
    assert!(there.iter().all(|byte| *byte == 7));
    lending.collect();
    assert_ne!(pool.free(), whole(), "taken back while it is being read");
    let part = there.slice(10..20);
    drop(there);
    lending.collect();
    assert_ne!(
        pool.free(),
        whole(),
        "taken back while a part of it is being read"
    );
    drop(part);
    lending.collect();
    assert_eq!(pool.free(), whole());
}

#[test]
fn what_stands_elsewhere_is_copied_once() {
    let (pool, mut lending, foreign) = pair();
    let bytes = Bytes::from(vec![3; 50_000]);
    let place = lending.lend(&bytes).unwrap();
    let there = foreign.borrow(place).unwrap();
    assert_eq!(there, bytes);
    assert!(pool.memory.place_of(&there).is_some());
}

#[test]
fn what_is_out_when_a_stream_ends_is_not_used_again_before_it_is_back_or_the_peer_is_gone() {
    for gone in [false, true] {
        let (pool, mut lending, foreign) = pair();
        let all = SMALL / 2 + PAGE;
        let place = lending.lend(&block(&pool, all, 5)).unwrap();
        let there = foreign.borrow(place).unwrap();
        drop(lending);
        drop(foreign);
        assert!(pool.block(all).is_none(), "it is being read");
        assert!(there.iter().all(|byte| *byte == 5));
        if gone {
            // As when its process is killed: nothing is given back, but the pipe ends.
            let there = std::mem::ManuallyDrop::new(there);
            let mut left = std::mem::take(&mut lock(&pool.state).left);
            let (ours, theirs) = pipe_with(PipeFlags::NONBLOCK).unwrap();
            drop(theirs);
            left[0].pipe = ours;
            lock(&pool.state).left = left;
            assert!(pool.block(all).is_some());
            drop(std::mem::ManuallyDrop::into_inner(there));
        } else {
            drop(there);
            assert!(pool.block(all).is_some());
        }
    }
}

#[test]
fn too_much_is_refused_and_room_comes_back() {
    let (pool, mut lending, foreign) = pair();
    let small = Bytes::from_static(&[1; 10]);
    let out: Vec<Bytes> = (0..SLOTS)
        .map(|_| foreign.borrow(lending.lend(&small).unwrap()).unwrap())
        .collect();
    assert!(lending.lend(&small).is_none());
    drop(out);
    assert!(lending.lend(&small).is_some());
    assert!(pool.block(SMALL + 1).is_none());
    assert!(pool.block(usize::MAX).is_none());
    let held = block(&pool, SMALL - SLOTS * PAGE, 0);
    assert!(pool.block(SLOTS * PAGE).is_none());
    drop(held);
    pool.close();
    assert!(pool.block(1).is_none());
}

#[test]
fn places_outside_are_refused() {
    let (_, _, foreign) = pair();
    let place = |slot, offset, length| Place {
        slot,
        offset,
        length,
    };
    for wrong in [
        place(SLOTS as u32, 0, 1),
        place(0, SMALL as u64, 1),
        place(0, 1, SMALL as u64),
        place(0, u64::MAX, 2),
        place(0, 2, u64::MAX),
        place(u32::MAX, 0, 0),
    ] {
        assert!(foreign.borrow(wrong).is_none(), "{wrong:?}");
    }
    assert!(foreign.borrow(place(0, 0, SMALL as u64)).is_some());
}

proptest! {
    #[test]
    fn blocks_never_overlap_and_all_room_comes_back(
        steps in proptest::collection::vec((1..SMALL / 8, any::<bool>(), any::<prop::sample::Index>()), 1..60),
    ) {
        let pool = Pool::of(Memory::private(SMALL), None);
        let mut blocks: Vec<Block> = Vec::new();
        for (size, takes, which) in steps {
            if takes {
                blocks.extend(pool.block(size));
            } else if !blocks.is_empty() {
                blocks.swap_remove(which.index(blocks.len()));
            }
            let mut parts: Vec<(usize, usize)> = blocks.iter().map(|block| (block.start, block.room)).collect();
            parts.extend(pool.free());
            parts.sort_unstable();
            let mut end = 0;
            for (start, room) in parts {
                prop_assert_eq!(start, end);
                end = start + room;
            }
            prop_assert_eq!(end, SMALL);
        }
        drop(blocks);
        prop_assert_eq!(pool.free(), whole());
    }
}

#[cfg(not(miri))]
#[test]
fn a_pool_that_was_passed_is_read_in_place_and_nobody_else_can_write_to_it() {
    let pool = Pool::make().unwrap();
    let (ours, [file, theirs]) = pool.offer().unwrap();
    let copy = file.try_clone().unwrap();
    let words = Words {
        memory: Arc::new(Memory::private(PAGE)),
        start: 0,
    };
    let mut lending = Lending::new(pool.clone(), words.clone(), ours);
    let foreign = Foreign::take([file, theirs], words.clone()).unwrap();
    let place = lending.lend(&block(&pool, 20_000, 9)).unwrap();
    let there = foreign.borrow(place).unwrap();
    assert!(there.len() == 20_000 && there.iter().all(|byte| *byte == 9));
    assert!(Memory::of_file(copy.as_fd(), SIZE).is_err());
    assert!(rustix::fs::ftruncate(&copy, 0).is_err());
    let loose = rustix::fs::memfd_create("loose", MemfdFlags::ALLOW_SEALING).unwrap();
    rustix::fs::ftruncate(&loose, SIZE as u64).unwrap();
    let (_, pipe) = pipe_with(PipeFlags::NONBLOCK).unwrap();
    assert!(Foreign::take([loose, pipe], words).is_err());
}
