//! Records of a snapshot buffer of another host, whose clock is wrong and drifts: read through a daemon there, in
//! virtual time. It holds the converted stamps against what must be true: a record was written after it was asked
//! to be and before that was confirmed.

use ctos::boot::{BootEvent, End, Fault, FaultKind, Observer, simulate};
use ctos::config::load_texts;
use ctos::registry::Registry;
use ctos::system::AppResult;
use ctos::task::{Context as TaskContext, Handled, Phase};
use ctos::time::Instant;
use sorma::daemon::{self, Tasks};
use sorma::ipc::{self, Host};
use sorma::{Dictionary, Request, Sorm, Transport};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

const APP: &str = r#"
app.until = "client"
[chassis.desk]
[chassis.cage]
[task.client]
handler = "client"
on = "desk"
[task.d1]
handler = "sorma.daemon"
on = "cage"
"#;

struct Client {
    sorm: Sorm,
}

#[ctos::handler]
impl Client {
    #[phase]
    async fn phase(&mut self, cx: &TaskContext, phase: Phase) -> Handled {
        if phase != Phase::Run {
            return Ok(());
        }
        let (here, sorm) = (cx.clone(), self.sorm.clone());
        cx.spawn(async move {
            let result = job(&here, &sorm).await;
            here.finish(AppResult {
                ok: result.is_ok(),
                text: result.unwrap_or_else(|error| error),
                json: String::new(),
            });
        });
        Ok(())
    }
}

async fn ask(cx: &TaskContext, sorm: &Sorm, line: &str) -> Result<Transport, String> {
    let request: Request = line.parse().unwrap();
    let reply = sorm.ask(&Tasks::of(cx), request).await;
    match reply.body.is_ok() {
        true => Ok(reply.body),
        false => Err(format!("{line}: {:?}", reply.body.reports)),
    }
}

/// Writes there and reads from here, again and again. Answers how often a clock was set and the least bound on the
/// error in ns. Also how many records contradict their stated time, and by how much the last stamp there was off.
async fn job(cx: &TaskContext, sorm: &Sorm) -> Result<String, String> {
    ask(cx, sorm, "shmem_w.pose@d1 CTRL -floats 1 -slots 8").await?;
    ask(cx, sorm, "shmem_far.pose CTRL -daemon d1 -drift 1e-3").await?;
    let mut bounds = Vec::new();
    let mut off = 0;
    let mut outside = 0;
    for index in 0..60_u32 {
        let before = cx.now();
        let line = format!("shmem_w.pose@d1 EXEC FMSG 1 {index}");
        ask(cx, sorm, &line).await?;
        let after = cx.now();
        cx.sleep(Duration::from_millis(u64::from(index % 7) * 150))
            .await;
        let read = ask(cx, sorm, "shmem_far.pose EXEC latest").await?;
        assert_eq!(read.floats, [f64::from(index)]);
        let [count, at, age, _generation, lost, bytes, error] = read.ints[..] else {
            return Err(format!("{:?}", read.ints));
        };
        assert_eq!((count, lost, bytes), (i64::from(index) + 1, 0, 0));
        let ns = |moment: Instant| i64::try_from(moment.as_nanos()).unwrap();
        if at + error < ns(before) || at - error > ns(after) {
            outside += 1;
        }
        assert_eq!(age, ns(cx.now()) - at);
        bounds.push(error);
        let there = ask(cx, sorm, "shmem_r.pose@d1 EXEC").await?.ints[1];
        off = there - at;
    }
    // What was not read yet, and nothing twice.
    ask(cx, sorm, "shmem_w.pose@d1 EXEC FMSG 1 -1").await?;
    ask(cx, sorm, "shmem_w.pose@d1 EXEC FMSG 1 -2").await?;
    let both = ask(cx, sorm, "shmem_far.pose EXEC all").await?;
    assert_eq!((both.floats, both.ints.len()), (vec![-1.0, -2.0], 14));
    assert_eq!(
        ask(cx, sorm, "shmem_far.pose EXEC all").await?.text,
        "not yet"
    );
    let clock = ask(cx, sorm, "shmem_far.pose EXEC clock").await?;
    let least = bounds.iter().min().unwrap();
    Ok(format!(
        "{} {least} {outside} {off} {:?}",
        clock.ints[0], clock.floats[2],
    ))
}

fn host(cx: &TaskContext, root: &Path) -> Host {
    Host {
        app: cx.chassis().name().to_owned(),
        clock: cx.chassis().clock().clone(),
        root: Some(root.to_owned()),
    }
}

/// Clock sets, least bound (ns), records outside of their bounds, stamp there minus time here (ns), estimated drift.
fn run(faults: &[Fault]) -> Vec<f64> {
    let folder = tempfile::tempdir().unwrap();
    // Made by the first that needs it, for this user alone.
    let root = folder.path().join("segments");
    let app = load_texts(&[("app.toml", APP)], &[], &[]).unwrap();
    let mut registry = Registry::new();
    let own = root.clone();
    daemon::register(&mut registry, Dictionary::new(), move |cx, sorm| {
        ipc::register(sorm, &host(cx, &own));
    });
    registry.handler("client", &Client::COMMANDS, move |cx| {
        let chassis = cx.chassis();
        let sorm = Sorm::of(chassis.name(), chassis.clock().clone(), Dictionary::new());
        ipc::register(&sorm, &host(cx, &root));
        Ok(Client { sorm })
    });
    let observer: Observer = Arc::new(|_: &BootEvent| ());
    let outcome = simulate(app, registry, faults, &observer).unwrap();
    match outcome.end {
        End::Finished(result) if result.ok => {
            let words = result.text.split(' ');
            words.map(|word| word.parse().unwrap()).collect()
        }
        other => panic!("{other:?}"),
    }
}

fn drift(ahead: Duration, rate_ppb: i32) -> Fault {
    Fault::on("cage", FaultKind::Drift { ahead, rate_ppb }, Instant::START)
}

fn delay(extra: Duration) -> Fault {
    Fault::between("desk", "cage", FaultKind::Delay { extra }, Instant::START)
        .until(Instant::from_nanos(3_600_000_000_000))
}

#[test]
fn records_of_a_host_whose_clock_is_wrong_have_the_time_here_within_the_bound() {
    for rate_ppb in [0, 900_000, -900_000, 40_000] {
        let ahead = Duration::from_secs(5);
        let found = run(&[drift(ahead, rate_ppb), delay(Duration::from_millis(20))]);
        let [sets, least, outside, off, rate] = found[..] else {
            panic!("{found:?}");
        };
        assert_eq!((sets, outside), (0.0, 0.0), "at {rate_ppb} ppb");
        // The longest way there and back bounds what one exchange leaves open.
        assert!(least < 45e6, "{least} ns");
        let elapsed_at_most = 120.0;
        let most = 5e9 + elapsed_at_most * f64::from(rate_ppb.abs());
        assert!((off - 5e9).abs() <= most - 5e9 + 45e6, "{off} ns off");
        assert!(rate.abs() <= 1e-3);
    }
}

#[test]
fn a_clock_that_drifts_faster_than_was_said_is_noticed_and_learnt_anew() {
    // Ten times the drift that -drift permits, on a quick link: two exchanges contradict each other.
    let found = run(&[drift(Duration::from_secs(1), 10_000_000)]);
    assert!(found[0] > 0.0, "{found:?}");
}
