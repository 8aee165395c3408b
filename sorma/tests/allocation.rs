//! An EXEC by reference allocates nothing: whatever needs memory was done at the first use.

#![allow(
    clippy::unwrap_used,
    reason = "helpers of tests stand outside test functions"
)]
#![allow(
    unsafe_code,
    reason = "an allocator can be written in no other way; this one hands every call on unchanged"
)]

use sorma::{Class, Context, Dictionary, Outcome, ServiceObject, Sorm, Transport};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

/// Counts what this thread allocates.
struct Counting;

// SAFETY: every call goes to the system's allocator as it came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|count| count.set(count.get() + 1));
        // SAFETY: the caller keeps the promises of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        // SAFETY: the caller keeps the promises of `dealloc`.
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn allocations(act: impl FnOnce()) -> usize {
    let before = ALLOCATIONS.with(Cell::get);
    act();
    ALLOCATIONS.with(Cell::get) - before
}

/// Adds up what it is given.
struct Sum;

impl ServiceObject for Sum {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let sum = io.floats.iter().sum();
        io.floats.clear();
        io.floats.push(sum);
        Ok(())
    }

    fn ctrl(&mut self, _cx: &Context<'_>, _io: &mut Transport) -> Outcome {
        Ok(())
    }

    fn dump(&self) -> String {
        String::new()
    }
}

#[test]
fn an_exec_by_reference_allocates_nothing_through_any_handle() {
    let sorm = Sorm::new(Dictionary::new());
    sorm.register(Class::new("sum", "1.0", |_, _| Ok(Box::new(Sum))));
    let handle = sorm.get("sum").unwrap();
    let mut io = Transport::floats([1.0, 2.0, 3.0]);
    handle.exec(&sorm, &mut io);
    assert_eq!(io.floats, [6.0]);

    let shared = allocations(|| {
        for _ in 0..1000 {
            handle.exec(&sorm, &mut io);
        }
    });
    assert_eq!(shared, 0);

    let mut claim = handle.claim().unwrap();
    let claimed = allocations(|| {
        for _ in 0..1000 {
            claim.exec(&sorm, &mut io);
        }
    });
    assert_eq!(claimed, 0);
    assert_eq!(io.floats, [6.0]);
}

#[test]
fn the_counter_counts() {
    assert_eq!(allocations(|| drop(std::hint::black_box(Box::new(1)))), 1);
}
