//! The cost of calling a service object: table 1.2 of the technical report, as far as it needs one
//! process. Beside it stand a plain function and a virtual call in the same run.

#![allow(
    clippy::unwrap_used,
    reason = "a benchmark may end when something is wrong"
)]

use divan::{Bencher, black_box};
use sorma::{Class, Context, Dictionary, Outcome, ServiceObject, Sorm, Transport};

fn main() {
    divan::main();
}

/// Does nothing.
struct Nop;

impl ServiceObject for Nop {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        black_box(io);
        Ok(())
    }

    fn ctrl(&mut self, _cx: &Context<'_>, _io: &mut Transport) -> Outcome {
        Ok(())
    }

    fn dump(&self) -> String {
        String::new()
    }
}

/// The same without a manager.
trait Plain {
    fn exec(&mut self, io: &mut Transport) -> Outcome;
}

impl Plain for Nop {
    fn exec(&mut self, io: &mut Transport) -> Outcome {
        black_box(io);
        Ok(())
    }
}

#[inline(never)]
fn function(io: &mut Transport) -> Outcome {
    black_box(io);
    Ok(())
}

fn manager() -> Sorm {
    let sorm = Sorm::new(Dictionary::new());
    sorm.register(Class::new("nop", "1.0", |_, _| Ok(Box::new(Nop))));
    sorm
}

/// F of the table.
#[divan::bench]
fn f_function_call(bencher: Bencher) {
    let mut io = Transport::default();
    bencher.bench_local(|| function(black_box(&mut io)));
}

#[divan::bench]
fn virtual_call(bencher: Bencher) {
    let mut io = Transport::default();
    let mut object: Box<dyn Plain> = black_box(Box::new(Nop));
    bencher.bench_local(|| object.exec(black_box(&mut io)));
}

/// TO of the table, held.
#[divan::bench]
fn to_claimed(bencher: Bencher) {
    let sorm = manager();
    let handle = sorm.get("nop").unwrap();
    let mut claim = handle.claim().unwrap();
    let mut io = Transport::default();
    bencher.bench_local(|| claim.exec(&sorm, black_box(&mut io)));
}

/// TO of the table, shared between threads.
#[divan::bench]
fn to_shared(bencher: Bencher) {
    let sorm = manager();
    let handle = sorm.get("nop").unwrap();
    let mut io = Transport::default();
    bencher.bench_local(|| handle.exec(&sorm, black_box(&mut io)));
}

/// S of the table.
#[divan::bench]
fn s_text(bencher: Bencher) {
    let sorm = manager();
    bencher.bench_local(|| sorm.dispatch(black_box("nop@self EXEC")));
}

/// S+10f of the table: ten floats in both directions.
#[divan::bench]
fn s_text_with_ten_floats(bencher: Bencher) {
    let sorm = manager();
    let line = "nop@self EXEC FMSG 10 0.1 -2.5 3.25e-3 4 5.125 -6.0625 7e7 0.3333333333333333 9 3.141592653589793";
    bencher.bench_local(|| sorm.dispatch(black_box(line)));
}
