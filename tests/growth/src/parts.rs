//! Nets, service objects and snapshot buffers by themselves, without an app.

use std::{fmt::Write as _, hint::black_box, sync::Arc};

use ctos::{diagnostic::Source, time::Clock};
use pnt::{
    analysis::explicit::Limits,
    check::{Options, Rule, prove},
    compile,
    exec::{Conflicts, Execution},
    layout::{Detail, Drawing},
    net::Net,
    stream::NetView,
};
use sorma::{Class, Context, Dictionary, Outcome, ServiceObject, Sorm, Transport};
use sorma_snapshot::{Layout, Place, Reader, Snapshot, Writer};

use crate::{
    areas::{Failed, cost, step},
    curve::Cost,
};

/// A ring of places and transitions, `size` nodes, with one token: as many markings as places.
fn ring(size: u64) -> Result<Arc<Net>, Failed> {
    let mut text = String::from("net ring\n");
    let length = (size / 2).max(1);
    for at in 0..length {
        let (tokens, next) = (u64::from(at == 0), (at + 1) % length);
        writeln!(
            text,
            "place p{at} = {tokens}\ntransition t{at}\n  in p{at}\n  out p{next}"
        )?;
    }
    let net = compile::net(&Source::new("ring.net", text));
    Ok(Arc::new(net.map_err(|findings| findings.to_string())?))
}

/// Reading and proving.
pub fn net_check(size: u64) -> Result<Cost, Failed> {
    let (cost, _) = cost(|| {
        let nets = [ring(size)?];
        let proof = prove(
            &nets,
            &Options::new(Rule::Closed, Limits::default()),
            &mut |_| (),
        );
        Ok(proof.map_err(|findings| findings.to_string())?)
    })?;
    Ok(cost)
}

/// One firing.
pub fn net_firing(size: u64) -> Result<Cost, Failed> {
    let mut execution = Execution::new(ring(size)?);
    let mut conflicts = Conflicts::Declared;
    step(10_000, || {
        let id = execution.choose(&mut conflicts, |_| true);
        execution.fire(id.ok_or("nothing is enabled")?)?;
        Ok(())
    })
}

/// What a display needs of a net before it shows it.
pub fn net_drawing(size: u64) -> Result<Cost, Failed> {
    let net = ring(size)?;
    let (cost, _) = cost(|| {
        let view = NetView::new(&net);
        Ok(Drawing::new(&view, Detail::Full))
    })?;
    Ok(cost)
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

/// A manager whose dictionary has so many flavors of one class.
fn manager(size: u64) -> Sorm {
    let mut dictionary = Dictionary::new();
    for at in 0..size {
        dictionary.add(format!("nop.f{at}"), Vec::new());
    }
    let sorm = Sorm::new(dictionary);
    sorm.register(Class::new("nop", "1", |_, _| Ok(Box::new(Nop))));
    sorm
}

fn build_all(sorm: &Sorm, size: u64) -> Result<(), Failed> {
    for at in 0..size {
        sorm.get(&format!("nop.f{at}"))
            .map_err(|report| report.to_string())?;
    }
    Ok(())
}

/// A dictionary of so many flavors, and an object of each.
pub fn objects(size: u64) -> Result<Cost, Failed> {
    let (cost, _) = cost(|| {
        let sorm = manager(size);
        build_all(&sorm, size)?;
        Ok(sorm)
    })?;
    Ok(cost)
}

/// Finding an object that is there.
pub fn objects_find(size: u64) -> Result<Cost, Failed> {
    let sorm = manager(size);
    build_all(&sorm, size)?;
    // A fixed set, so that the processor's caches see as many names among few and among many.
    let names: Vec<String> = (0..1000)
        .map(|at| format!("nop.f{}", at * 7919 % size))
        .collect();
    let mut at = 0;
    step(10_000, || {
        at = (at + 1) % names.len();
        black_box(
            sorm.get(black_box(&names[at]))
                .map_err(|report| report.to_string())?,
        );
        Ok(())
    })
}

/// A record is written, and every reader reads it.
pub fn readers(size: u64) -> Result<Cost, Failed> {
    let folder = tempfile::tempdir()?;
    let place = Place::under(&folder.path().join("shm"), "growth")?;
    let clock = Clock::real();
    let mut writer = Writer::create(&place, "buffer", Layout::new(8, 18), &clock)?;
    let floats = [0.5; 18];
    writer.write(&floats, &[])?;
    let (opened, mut readers) = cost(|| {
        let all = (0..size).map(|_| Reader::open(&place, "buffer"));
        Ok(all.collect::<Result<Vec<_>, _>>()?)
    })?;
    let mut snapshot = Snapshot::default();
    let round = step(100, || {
        writer.write(&floats, &[])?;
        for reader in &mut readers {
            reader.latest(&mut snapshot)?;
        }
        Ok(())
    })?;
    Ok(Cost {
        bytes: opened.bytes,
        ..round
    })
}
