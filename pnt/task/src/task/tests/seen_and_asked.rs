//! What is seen of a durable net, and what is asked of it again, when it dies at any moment. Nothing that was
//! seen is lost, and nothing that was asked is done twice.

use ctos::{
    simulation::{Fault, FaultKind, Faults},
    time::Instant,
};

use super::{
    survival::{
        durable_app, insist, register_script, register_with_settings, seeds, simulate, tokens,
    },
    *,
};
use crate::stream::{Batch, Follow as FollowNet};

/// Its tally only ever grows.
const COUNTER: &str = "net n
place src = 200, tally
transition count
  in src
  out tally
  time 7 ms
transition never
  in tally*1000
  out tally*1000
";

/// Watches the net's tally through its stream and its snapshots. Whenever the net is there again it must hold
/// at least what was seen before.
async fn watch_the_tally(cx: Context) -> Result<String, HandlerError> {
    let (mut seen, mut after, mut lives) = (0, None, 0);
    while seen < 200 {
        let batch: Batch = insist(
            &cx,
            "n",
            FollowNet {
                after,
                patience_ms: 300,
            },
        )
        .await?;
        if let Some(state) = &batch.state {
            lives += 1;
            let [_, tally] = state.places.as_slice() else {
                return Err("a state of another net".into());
            };
            if *tally < seen {
                return Err(format!("{seen} were seen, and now there are {tally}").into());
            }
            seen = *tally;
        }
        for event in batch.events.iter() {
            seen += event.produced.iter().map(|(_, count)| count).sum::<u32>();
        }
        after = Some(batch.mark);
        let tally = tokens(&insist(&cx, "n", Marking {}).await?, "tally");
        if tally < seen {
            return Err(format!("{seen} were seen, and {tally} are told").into());
        }
    }
    Ok(format!("{seen} in more lives than one: {}", lives > 1))
}

#[test]
fn what_a_display_has_seen_of_a_durable_net_is_never_lost_whenever_the_net_dies() {
    for seed in 0..seeds(20) as u64 {
        let app = durable_app(&[("n", "durable = true")], seed);
        let mut registry = Registry::new();
        register_with_settings(&mut registry, COUNTER, || Library::new(()));
        register_script(&mut registry, watch_the_tally);
        let kills = (1..12_u64).map(|number| {
            Fault::on(
                "on_n",
                FaultKind::Kill,
                Instant::from_nanos(number * 150_000_000 + seed * 370_000),
            )
        });
        let script = Faults::of_script("deaths", kills.collect());
        let (found, kills) = simulate(app, registry, script);
        assert_eq!(
            found.as_deref(),
            Ok("200 in more lives than one: true"),
            "seed {seed}, {kills} deaths"
        );
    }
}

/// One command at a time, done by an action that may be asked again.
const ONE: &str = "net n
place free = 1, done, times
command go -> gone
transition work
  in free
  tape go
  do work
  idempotent
  out done, times
transition answer
  in done
  out free
  write gone
";

fn request(number: u64) -> PutOnce {
    PutOnce {
        request: RequestId {
            from: "desk".to_owned(),
            number,
        },
        symbol: "go".to_owned(),
        arguments: Vec::new(),
    }
}

#[test]
fn a_command_that_is_asked_for_again_is_put_once_whenever_its_net_dies() {
    async fn ask(cx: Context) -> Result<String, HandlerError> {
        let mut said = Vec::new();
        for number in [1, 2, 2, 1] {
            said.push(insist(&cx, "n", request(number)).await?.symbol);
        }
        let snapshot = insist(&cx, "n", Marking {}).await?;
        Ok(format!(
            "{} times {} output {}",
            said.join(" "),
            tokens(&snapshot, "times"),
            snapshot.output.len()
        ))
    }
    for step in 0..120_u64 {
        let app = durable_app(&[("n", "durable = true")], step);
        let mut registry = Registry::new();
        register_with_settings(&mut registry, ONE, || {
            Library::new(()).action("work", slow(Duration::from_millis(100)))
        });
        register_script(&mut registry, ask);
        let kills = [0, 1, 2].map(|again| {
            Fault::on(
                "on_n",
                FaultKind::Kill,
                Instant::from_nanos(1_000_000 + step * 3_000_000 + again * 170_000_000),
            )
        });
        let script = Faults::of_script("deaths", kills.to_vec());
        let found = simulate(app, registry, script).0;
        assert_eq!(
            found.as_deref(),
            Ok("gone gone gone gone times 2 output 0"),
            "step {step}"
        );
    }
}

#[test]
fn who_puts_a_command_once_learns_nothing_of_a_process_that_is_stopped_in_order_and_begun_again() {
    async fn ask(cx: Context) -> Result<String, HandlerError> {
        for number in 1..=6 {
            let answer = put_once(&cx, "n", &request(number), Duration::from_secs(600)).await?;
            if answer.symbol != "gone" {
                return Err(format!("{number}: {answer:?}").into());
            }
        }
        let snapshot = insist(&cx, "n", Marking {}).await?;
        Ok(format!("times {}", tokens(&snapshot, "times")))
    }
    for step in 0..60_u64 {
        let app = durable_app(&[("n", "durable = true")], step);
        let mut registry = Registry::new();
        register_with_settings(&mut registry, ONE, || {
            Library::new(()).action("work", slow(Duration::from_millis(100)))
        });
        register_script(&mut registry, ask);
        // As after a freeze of the boot, whose chassis stop their tasks and are started again.
        let restart = Fault::on(
            "on_n",
            FaultKind::Restart,
            Instant::from_nanos(1_000_000 + step * 9_000_000),
        );
        let script = Faults::of_script("restart", vec![restart]);
        let found = simulate(app, registry, script).0;
        assert_eq!(found.as_deref(), Ok("times 6"), "step {step}");
    }
}

/// A net whose action is a command to the one above.
const ASKS: &str = "net m
place ready = 3, free = 1, over, lost
transition ask
  in ready, free
  send n.go
  within 600 s
  out over, free
  fail lost, free
transition never
  in over*9
  out over*9
";

#[test]
fn a_command_from_net_to_net_is_done_once_whenever_either_of_them_dies() {
    async fn wait(cx: Context) -> Result<String, HandlerError> {
        loop {
            let m = insist(&cx, "m", Marking {}).await?;
            if tokens(&m, "over") + tokens(&m, "lost") == 3 {
                let n = insist(&cx, "n", Marking {}).await?;
                return Ok(format!(
                    "over {} times {} {:?}",
                    tokens(&m, "over"),
                    tokens(&n, "times"),
                    m.halted
                ));
            }
            if cx.now().since_start() > Duration::from_secs(2000) {
                return Err(format!("{m:?}").into());
            }
            cx.sleep(Duration::from_millis(200)).await;
        }
    }
    for step in 0..80_u64 {
        let both = [("m", "durable = true"), ("n", "durable = true")];
        let app = durable_app(&both, step);
        let mut registry = Registry::new();
        register_with_settings(&mut registry, ASKS, || Library::new(()));
        register_with_settings(&mut registry, ONE, || {
            Library::new(()).action("work", slow(Duration::from_millis(100)))
        });
        register_script(&mut registry, wait);
        let kill = |chassis: &str, at: u64| {
            Fault::on(chassis.to_owned(), FaultKind::Kill, Instant::from_nanos(at))
        };
        let (first, second) = (1_000_000 + step * 5_000_000, 90_000_000);
        let kills = vec![kill("on_m", first), kill("on_n", first + second)];
        let script = Faults::of_script("deaths", kills);
        let found = simulate(app, registry, script).0;
        assert_eq!(found.as_deref(), Ok("over 3 times 3 None"), "step {step}");
    }
}
