//! Trading, load balancing and demand streams. Three daemons offer the same class with different prices, and a client
//! has the best of them work on a stream of frames. In virtual time, so that it is the same every time.
//!
//! ```text
//! cargo run -p sorma --example market
//! ```

use ctos::{
    boot::{BootEvent, End, Observer, simulate},
    config::load_texts,
    diagnostic::Source,
    registry::Registry,
    system::AppResult,
    task::{Context, Handled, Phase},
};
use sorma::{
    Class, Dictionary, Keep, OptionTable, Outcome, ServiceObject, Sorm, Transport, Waiting,
    daemon::{self, Tasks},
};
use std::{
    fmt::Write as _,
    sync::{Arc, LazyLock},
    time::Duration,
};

/// Three daemons on chassis of their own, with what each offers, and the client.
const APP: &str = r#"
app.until = "client"
[chassis.desk]
[chassis.one]
[chassis.two]
[chassis.three]

[task.d1]
handler = "sorma.daemon"
on = "one"
args.offers.blobs = { camera = "left", price = 3 }

[task.d2]
handler = "sorma.daemon"
on = "two"
args.offers.blobs = { camera = "left", price = 1 }

[task.d3]
handler = "sorma.daemon"
on = "three"
args.offers.blobs = { camera = "right", price = 2 }

[task.client]
handler = "client"
on = "desk"
"#;

/// What the client wants: a class, and an alias, that are traded. No line of code names a daemon.
const COOKBOOK: &str = "\
BLOBS trade camera=left -least price
anyone trade -spread
stream.frames -from event.frames -keep every -to blobs@anyone
";

/// Counts blobs in a frame, which takes its time.
#[derive(Clone, Default)]
struct Blobs;

static BLOBS: LazyLock<OptionTable<Blobs>> = LazyLock::new(|| OptionTable::new("finds blobs"));

impl ServiceObject for Blobs {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        io: &'a mut Transport,
    ) -> sorma::object::Later<'a> {
        Some(Box::pin(async move {
            cx.sleep(Duration::from_millis(100)).await;
            io.text = format!("{} by {}", io.text, cx.here().sorm().process());
            Ok(())
        }))
    }

    fn ctrl(&mut self, _: &sorma::Context<'_>, io: &mut Transport) -> Outcome {
        BLOBS.ctrl(self, io);
        Ok(())
    }

    fn dump(&self) -> String {
        BLOBS.dump(self)
    }
}

fn classes(sorm: &Sorm) {
    sorm.register(Class::new("blobs", "1.0", |_, _| Ok(Box::new(Blobs))).waits());
}

/// Goes through it, and says what came of it.
async fn shown(cx: &Context, sorm: &Sorm) -> Result<String, String> {
    let comm = Tasks::of(cx);
    let mut told = String::new();
    let ask = async |line: &str| -> Result<String, String> {
        let request = line.parse().map_err(|error| format!("{error}"))?;
        let body = sorm.ask(&comm, request).await.body;
        match body.is_ok() {
            true => Ok(body.text),
            false => Err(body.reports.iter().map(ToString::to_string).collect()),
        }
    };
    let cannot = |error: std::fmt::Error| error.to_string();

    // Trading: the least price of those with the left camera; when it is withdrawn, the next one.
    writeln!(told, "traded: {}", ask("BLOBS EXEC frame").await?).map_err(cannot)?;
    ask("sorm@d2 CTRL -withdraw blobs").await?;
    cx.sleep(Duration::from_secs(2)).await;
    ask("BLOBS EXEC frame").await?;
    cx.sleep(Duration::from_secs(1)).await;
    writeln!(told, "without d2: {}", ask("BLOBS EXEC frame").await?).map_err(cannot)?;
    ask("sorm@d2 CTRL -offer blobs 'camera=left price=1'").await?;
    cx.sleep(Duration::from_secs(2)).await;
    ask("blobs@anyone EXEC frame").await?;
    cx.sleep(Duration::from_secs(1)).await;

    // Load balancing: six at once are as long under way as two.
    let requests = (1..=6).map(|number| format!("blobs@anyone EXEC frame{number}").parse());
    let requests = requests.collect::<Result<Vec<_>, _>>();
    let requests = requests.map_err(|error| format!("{error}"))?;
    let begun = cx.now();
    let replies = sorm.fork(&comm, requests, 6).await;
    let mut by: Vec<&str> = replies
        .iter()
        .filter_map(|reply| reply.body.text.split(" by ").nth(1))
        .collect();
    by.sort_unstable();
    let took = cx.now().since(begun).as_secs_f64();
    writeln!(told, "balanced: {} in {took:.1} s", by.join(" ")).map_err(cannot)?;

    // Demand streams: the frames go on to a free daemon, and another subscriber sees each of them too.
    let frames = sorm.subscribe(&comm, "event.frames", Keep::Every(10));
    let mut frames = frames.await.map_err(|report| report.to_string())?;
    ask("stream.frames EXEC begin").await?;
    for number in 1..=3 {
        ask(&format!("event.frames EXEC picture{number}")).await?;
    }
    cx.sleep(Duration::from_secs(1)).await;
    let mut seen = Vec::new();
    while let Some(sample) = frames.try_next() {
        seen.push(sample.body.text);
    }
    writeln!(told, "streamed: {}", seen.join(" ")).map_err(cannot)?;
    for daemon in ["d1", "d2", "d3"] {
        let meter = ask(&format!("blobs@{daemon} DBX -meter")).await?;
        let calls = meter.split("calls ").nth(1).unwrap_or_default();
        let calls = calls.split(' ').next().unwrap_or_default();
        writeln!(told, "{daemon} has met {calls}").map_err(cannot)?;
    }
    Ok(told)
}

struct Client {
    sorm: Sorm,
}

#[ctos::handler]
impl Client {
    #[phase]
    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase != Phase::Run {
            return Ok(());
        }
        let (here, sorm) = (cx.clone(), self.sorm.clone());
        cx.spawn(async move {
            let result = shown(&here, &sorm).await;
            here.finish(AppResult {
                ok: result.is_ok(),
                text: result.unwrap_or_else(|why| why),
                json: String::new(),
            });
        });
        Ok(())
    }
}

/// Runs the app; what came of it.
///
/// # Errors
/// What went wrong.
pub fn run() -> Result<String, String> {
    let app = load_texts(&[("market.toml", APP)], &[], &[]);
    let app =
        app.map_err(|findings| findings.iter().map(ToString::to_string).collect::<String>())?;
    let mut registry = Registry::new();
    daemon::register(&mut registry, Dictionary::new(), |_, sorm| classes(sorm));
    registry.handler("client", &Client::COMMANDS, |cx| {
        let mut dictionary = Dictionary::new();
        let cookbook = Source::new("cookbook", format!("event.frames\n{COOKBOOK}"));
        dictionary.load(&cookbook).map_err(|findings| {
            let said: Vec<String> = findings.iter().map(ToString::to_string).collect();
            ctos::task::HandlerError::new(said.join("\n"))
        })?;
        let chassis = cx.chassis();
        let sorm = Sorm::of(chassis.name(), chassis.clock().clone(), dictionary);
        sorma::asynchronous::register(&sorm);
        classes(&sorm);
        Ok(Client { sorm })
    });
    let observer: Observer = Arc::new(|_: &BootEvent| ());
    let outcome = simulate(app, registry, &[], &observer);
    match outcome.map_err(|error| error.to_string())?.end {
        End::Finished(result) if result.ok => Ok(result.text),
        End::Finished(result) => Err(result.text),
        other => Err(format!("{other:?}")),
    }
}

#[allow(dead_code, reason = "the tests call `run`")]
#[expect(clippy::print_stdout, reason = "that is what the example is for")]
fn main() -> Result<(), String> {
    print!("{}", run()?);
    Ok(())
}
