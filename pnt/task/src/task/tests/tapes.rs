//! The output tape, and what becomes of nets whose partner is lost.

use ctos::{
    simulation::{Fault, FaultKind, Faults},
    time::Instant,
};

use super::{
    survival::{durable_app, insist, register_script, register_with_settings, simulate},
    *,
};

const FETCH: &str = "net n
place free = 1, asked
command fetch -> fetched
transition begin
  in free
  tape fetch
  do walk
  out asked
transition end
  in asked
  out free
  write fetched
";

/// Asks for something, and goes away before it is there.
async fn ask_and_go(cx: &Context, what: &str) -> String {
    let Ok(to) = cx.task("n").await else {
        return "nobody".to_owned();
    };
    let put = PutTape {
        symbol: "fetch".to_owned(),
        arguments: vec![what.to_owned()],
    };
    let asked = cx.timeout(Duration::from_millis(100), async {
        cx.call(&to, put).await
    });
    let said = match asked.await {
        Err(_) => "gone".to_owned(),
        Ok(Ok(answer)) => answer.symbol,
        Ok(Err(error)) => error.reason(),
    };
    // What was begun ends meanwhile.
    cx.sleep(Duration::from_secs(2)).await;
    said
}

async fn read(cx: &Context, taken: u64) -> Result<String, HandlerError> {
    let outputs = insist(cx, "n", ReadTape { taken }).await?;
    let lines = outputs.iter().map(|output| {
        let Output {
            number,
            command,
            arguments,
            answer,
        } = output;
        format!("{number} {command} {arguments:?} {}", answer.symbol)
    });
    Ok(lines.collect::<Vec<_>>().join(", "))
}

#[test]
fn answers_that_nobody_waits_for_are_on_the_output_tape_in_order_and_it_is_bounded() {
    let mut registry = Registry::new();
    register_with_settings(&mut registry, FETCH, || {
        Library::new(()).action("walk", slow(Duration::from_millis(500)))
    });
    register_script(&mut registry, |cx| async move {
        let mut said = Vec::new();
        for what in ["bolt", "nut", "washer"] {
            said.push(ask_and_go(&cx, what).await);
        }
        said.push(read(&cx, 0).await?);
        // The reader says what it has: only that is removed.
        said.push(read(&cx, 1).await?);
        said.push(ask_and_go(&cx, "washer").await);
        said.push(read(&cx, 1).await?);
        Ok(said.join("\n"))
    });
    let app = durable_app(&[("n", "tape = 2")], 1);
    let found = simulate(app, registry, Faults::none()).0.unwrap();
    let said: Vec<&str> = found.lines().collect();
    let full = "the output tape of net `n` is full: 2 answers wait on it to be read (`read_tape`)";
    assert!(said[2].contains(full), "{found}");
    let others: Vec<&str> = said.iter().copied().filter(|one| *one != said[2]).collect();
    let expected = [
        "gone",
        "gone",
        "1 fetch [\"bolt\"] fetched, 2 fetch [\"nut\"] fetched",
        "2 fetch [\"nut\"] fetched",
        "gone",
        "2 fetch [\"nut\"] fetched, 3 fetch [\"washer\"] fetched",
    ];
    assert_eq!(others, expected);
}

#[test]
fn a_net_that_exchanges_tokens_with_one_that_is_lost_stops_and_says_so() {
    const A: &str = "net a\nplace src = 9, free = 1\ntransition t\n  in src, free\n  do walk\n  out free, mid@b\n";
    const B: &str = "net b\nplace mid, held\ntransition t\n  in mid\n  out held\n";
    // The first token goes after half a second: a partner may die before.
    let deaths = [300_000_000, 1_700_000_000];
    let kinds = [("durable = false", true), ("durable = true", false)];
    for ((durable, stops), dies_at) in kinds
        .into_iter()
        .flat_map(|kind| deaths.map(|at| (kind, at)))
    {
        let mut registry = Registry::new();
        for text in [A, B] {
            register_with_settings(&mut registry, text, || {
                Library::new(()).action("walk", slow(Duration::from_millis(500)))
            });
        }
        register_script(&mut registry, |cx| async move {
            cx.sleep(Duration::from_secs(30)).await;
            let now = insist(&cx, "a", Marking {}).await?;
            Ok(now.halted.unwrap_or_default())
        });
        let death = Fault::on("on_b", FaultKind::Kill, Instant::from_nanos(dies_at));
        let script = Faults::of_script("a death", vec![death]);
        let app = durable_app(&[("a", durable), ("b", durable)], 1);
        let halted = simulate(app, registry, script).0.unwrap();
        let said = "net `b` is gone with chassis `on_b`";
        let expected = if stops { said } else { "" };
        assert_eq!(halted, expected, "{durable}, dies at {dies_at} ns");
    }
}
