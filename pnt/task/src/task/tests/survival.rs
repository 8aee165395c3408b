//! What survives the death of processes and links: tokens, commands, actions, in virtual time over many
//! seeds.

use std::sync::{
    Mutex,
    atomic::{AtomicU32, Ordering},
};

use ctos::{
    message::Command,
    simulation::{self, Fault, FaultKind, Faults, Setup},
    time::Instant,
};

use super::*;

/// How many seeds a question about deaths is asked with: `CTOS_SEEDS`, or so many.
pub(super) fn seeds(short: usize) -> usize {
    let wanted = std::env::var("CTOS_SEEDS").ok();
    wanted.map_or(short, |text| text.parse().unwrap())
}

/// A chain of three nets: tokens go from `a` through `b` to `c`. Some go through actions that may be
/// asked again, some through actions that may not.
const A: &str = "net a
place src = 20, free = 2
transition take
  in src, free
  do work
  out mid@b*2, free
  fail src, free
";
const B: &str = "net b
place mid, free = 2, tally
transition pass
  in mid, free
  do work
  idempotent
  out end@c, tally, free
";
const C: &str = "net c
place end
transition never
  in end*100000
  out end*100000
";

/// Each net durable or not, on a chassis of its own that comes back; the operator on another.
pub(super) fn durable_app(nets: &[(&str, &str)], seed: u64) -> App {
    durable_app_with(nets, seed, &[])
}

/// The same with settings as `--set` takes them.
pub(super) fn durable_app_with(nets: &[(&str, &str)], seed: u64, sets: &[String]) -> App {
    let mut text = format!(
        "[app]\nname = \"t\"\nuntil = \"operator\"\nseed = {seed}\n[time]\nmode = \"virtual\"\n[chassis.desk]\nrestart = \"always\"\nmax_restarts = 100000\nrestart_backoff_s = 0.05\n[task.operator]\nhandler = \"operator\"\non = \"desk\"\n"
    );
    for (name, more) in nets {
        text.push_str(&format!(
            "[chassis.on_{name}]\nrestart = \"always\"\nmax_restarts = 100000\nrestart_backoff_s = 0.05\n[task.{name}]\nhandler = \"{name}\"\non = \"on_{name}\"\nargs = {{ net = \"{name}.net\", {more} }}\n"
        ));
    }
    config::load_texts(&[("app.toml", &text)], sets, &[]).unwrap_or_else(|f| panic!("{f}"))
}

/// Registers a net with the settings of its task.
pub(super) fn register_with_settings<S: 'static>(
    registry: &mut Registry,
    text: &str,
    library: impl Fn() -> Library<S> + Send + Sync + 'static,
) {
    let net = compile::net(&Source::new("test.net", text)).unwrap_or_else(|f| panic!("{f}"));
    let name = net.name().to_owned();
    registry.handler(&name, &COMMANDS, move |cx| {
        let settings = settings(cx.config().unwrap())?;
        NetTask::with_settings(cx, net.clone(), library(), None, settings)
    });
}

fn working(takes: Duration) -> Library<()> {
    Library::new(()).action("work", slow(takes))
}

type Script = Rc<dyn Fn(Context) -> Later<Result<String, HandlerError>>>;

/// Runs a script as the app's operator.
struct Scripted(Script);

impl EventHandler for Scripted {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (child, script) = (cx.clone(), Rc::clone(&self.0));
            cx.spawn(async move {
                let result = script(child.clone()).await;
                let ok = result.is_ok();
                let text = result.unwrap_or_else(|error| error.to_string());
                child.finish(AppResult {
                    ok,
                    text,
                    json: String::new(),
                });
            });
        }
        Ok(())
    }
}

/// Registers an operator that does what `script` says.
pub(super) fn register_script<F>(registry: &mut Registry, script: fn(Context) -> F)
where
    F: Future<Output = Result<String, HandlerError>> + 'static,
{
    registry.handler("operator", &[], move |_| {
        Ok(Scripted(Rc::new(move |cx| Box::pin(script(cx)))))
    });
}

/// Runs an app with faults; what its operator found, and how often a chassis died.
pub(super) fn simulate(
    app: App,
    registry: Registry,
    faults: Faults,
) -> (Result<String, String>, usize) {
    let setup = Setup {
        faults,
        ..Setup::default()
    };
    let observer: boot::Observer = Arc::new(|_| {});
    let run = simulation::run(app, registry, setup, &observer).unwrap();
    let kills = run.faults.iter();
    let kills = kills.filter(|fault| fault.kind == FaultKind::Kill).count();
    let result = match run.outcome.end {
        End::Finished(AppResult { ok: true, text, .. }) => Ok(text),
        End::Finished(AppResult { text, .. }) => Err(text),
        other => Err(format!("{other:?}")),
    };
    (result, kills)
}

/// Asks a task that may be away, until it answers.
pub(super) async fn insist<C: Command + Clone>(
    cx: &Context,
    task: &str,
    request: C,
) -> Result<C::Reply, HandlerError> {
    loop {
        let answer = match cx.wait_for_task(task, Duration::from_secs(60)).await {
            Ok(to) => cx
                .call(&to, request.clone())
                .await
                .map_err(HandlerError::from),
            Err(error) => Err(error.into()),
        };
        match answer {
            Ok(answer) => return Ok(answer),
            Err(error) if cx.now().since_start() > Duration::from_secs(3000) => return Err(error),
            Err(_) => cx.sleep(Duration::from_millis(50)).await,
        }
    }
}

pub(super) fn tokens(snapshot: &Snapshot, place: &str) -> u32 {
    let mut places = snapshot.places.iter();
    let found = places.find(|(name, _)| name == place);
    found.map_or(0, |(_, tokens)| *tokens)
}

/// Waits until all tokens have come to the end, and longer, and says what is where.
async fn watch_the_chain(cx: Context) -> Result<String, HandlerError> {
    while tokens(&insist(&cx, "c", Marking {}).await?, "end") < 40 {
        if cx.now().since_start() > Duration::from_secs(2000) {
            return Err("the tokens did not arrive".into());
        }
        cx.sleep(Duration::from_millis(200)).await;
    }
    cx.sleep(Duration::from_secs(10)).await;
    let a = insist(&cx, "a", Marking {}).await?;
    let b = insist(&cx, "b", Marking {}).await?;
    let c = insist(&cx, "c", Marking {}).await?;
    Ok(format!(
        "src {} free {} mid {} free {} tally {} end {} running {:?} {:?}",
        tokens(&a, "src"),
        tokens(&a, "free"),
        tokens(&b, "mid"),
        tokens(&b, "free"),
        tokens(&b, "tally"),
        tokens(&c, "end"),
        a.in_action,
        b.in_action,
    ))
}

fn chain(seed: u64, faults: Faults) -> (Result<String, String>, usize) {
    let durable = "durable = true";
    let app = durable_app(&[("a", durable), ("b", durable), ("c", durable)], seed);
    let mut registry = Registry::new();
    register_with_settings(&mut registry, A, || working(Duration::from_millis(120)));
    register_with_settings(&mut registry, B, || working(Duration::from_millis(80)));
    register_with_settings(&mut registry, C, || Library::new(()));
    register_script(&mut registry, watch_the_chain);
    simulate(app, registry, faults)
}

fn faults(text: &str) -> Faults {
    Faults::parse(&Source::new("faults.toml", text)).unwrap_or_else(|f| panic!("{f}"))
}

const WHERE_ALL_MUST_BE: &str = "src 0 free 2 mid 0 free 2 tally 40 end 40 running [] []";

#[test]
fn no_token_is_lost_or_doubled_whatever_dies_whenever() {
    let (mut deaths, seeds) = (0, seeds(30));
    for seed in 0..seeds as u64 {
        // Everything dies about once in two seconds until it is over, which takes about two.
        let mut script = Vec::new();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        for chassis in ["on_a", "on_b", "on_c"] {
            for _ in 0..6 {
                let at = Instant::from_nanos(rng.random_range(0..9_000_000_000));
                let chassis = chassis.to_owned();
                script.push(Fault::on(chassis, FaultKind::Kill, at));
            }
        }
        let faults = Faults::of_script("deaths", script);
        let (found, kills) = chain(seed, faults);
        assert_eq!(found.as_deref(), Ok(WHERE_ALL_MUST_BE), "seed {seed}");
        deaths += kills;
    }
    assert!(deaths > 12 * seeds, "{deaths} deaths");
}

#[test]
fn no_token_is_lost_or_doubled_on_links_that_drop_delay_stall_and_are_cut() {
    let bad = "[loss]\nper_s = 1\nlasts_s = [0.05, 1.0]\nshare = [0.2, 0.8]\n[delay]\nper_s = 1\nlasts_s = [0.1, 2.0]\nextra_s = [0.001, 0.3]\n[stall]\nper_s = 0.2\nlasts_s = [0.1, 4.0]\n[cut]\nper_s = 0.2\nlasts_s = [0.1, 4.0]\n";
    for seed in 0..seeds(6) as u64 {
        let (found, _) = chain(seed, faults(bad));
        assert_eq!(found.as_deref(), Ok(WHERE_ALL_MUST_BE), "seed {seed}");
    }
}

#[test]
fn the_same_seed_gives_the_same_deaths_and_the_same_end() {
    let kill = |at| Fault::on("on_b", FaultKind::Kill, Instant::from_nanos(at));
    let script = || Faults::of_script("deaths", vec![kill(700_000_000), kill(900_000_000)]);
    assert_eq!(chain(5, script()), chain(5, script()));
}

/// One command at a time, done by an action that takes a while.
const N: &str = "net n
place free = 1, done, doubted, times
command go -> gone, failed
transition work
  in free
  tape go
  do work
  out done, times
  fail doubted
transition answer
  in done
  out free
  write gone
transition give_up
  in doubted
  out free
  write failed
";

static STARTED: AtomicU32 = AtomicU32::new(0);

/// Puts a command, and finds its answer wherever it is.
async fn one_command(cx: Context) -> Result<String, HandlerError> {
    let to = cx.task("n").await?;
    let put = PutTape {
        symbol: "go".to_owned(),
        arguments: vec!["x".to_owned()],
    };
    let answered = cx.call(&to, put).await;
    cx.sleep(Duration::from_secs(5)).await;
    let snapshot = insist(&cx, "n", Marking {}).await?;
    let output = insist(&cx, "n", ReadTape { taken: 0 }).await?;
    let again = insist(&cx, "n", ReadTape { taken: 1 }).await?;
    let answers: Vec<String> = output
        .iter()
        .map(|output| {
            format!(
                "{} {:?} {}",
                output.command, output.arguments, output.answer.symbol
            )
        })
        .collect();
    Ok(format!(
        "answered {:?} output {answers:?} left {} times {} free {} tape {:?} {:?}",
        answered.ok().map(|answer| answer.symbol),
        again.len(),
        tokens(&snapshot, "times"),
        tokens(&snapshot, "free"),
        snapshot.tape,
        snapshot.in_progress,
    ))
}

fn one_command_killed_at(ns: u64) -> String {
    let app = durable_app(&[("n", "durable = true")], 3);
    let mut registry = Registry::new();
    register_with_settings(&mut registry, N, || working(Duration::from_millis(300)));
    register_script(&mut registry, one_command);
    let kill = Fault::on("on_n", FaultKind::Kill, Instant::from_nanos(ns));
    simulate(app, registry, Faults::of_script("a death", vec![kill]))
        .0
        .unwrap()
}

#[test]
fn a_command_is_answered_in_doubt_or_never_begun_whenever_its_net_dies() {
    let ends = [
        // Done, and the answer was lost on its way.
        "answered None output [] left 0 times 1 free 1 tape [] None",
        // Never taken: the caller knows that it is gone.
        "answered None output [] left 0 times 0 free 1 tape [] None",
        // It went on: in doubt, and the answer is kept.
        "answered None output [\"go [\\\"x\\\"] failed\"] left 0 times 0 free 1 tape [] None",
        // Begun anew from the tape, or done and not answered any more.
        "answered None output [\"go [\\\"x\\\"] gone\"] left 0 times 1 free 1 tape [] None",
        // Before it was put, or after all was over.
        "answered Some(\"gone\") output [] left 0 times 1 free 1 tape [] None",
    ];
    let mut seen = [0; 5];
    for step in 0..160 {
        let found = one_command_killed_at(1_000_000 + step * 4_000_000);
        let end = ends.iter().position(|end| *end == found);
        seen[end.unwrap_or_else(|| panic!("step {step}: {found}"))] += 1;
    }
    assert!(seen[2] > 10 && seen[4] > 10, "{seen:?}");
}

#[test]
fn an_action_in_doubt_without_a_failure_branch_stops_the_net_and_an_idempotent_one_is_asked_again()
{
    let text = |more: &str| {
        format!(
            "net n\nplace a = 1, b\ntransition t\n  in a\n  do work\n{more}  out b\ntransition never\n  in b*9\n  out b*9\n"
        )
    };
    async fn look(cx: Context) -> Result<String, HandlerError> {
        cx.sleep(Duration::from_secs(8)).await;
        let snapshot = insist(&cx, "n", Marking {}).await?;
        let halted = snapshot.halted.clone().unwrap_or_default();
        Ok(format!(
            "a {} b {} {:?} {halted}",
            tokens(&snapshot, "a"),
            tokens(&snapshot, "b"),
            snapshot.in_action
        ))
    }
    let run = |text: String| {
        let app = durable_app(&[("n", "durable = true")], 1);
        let mut registry = Registry::new();
        register_with_settings(&mut registry, &text, || {
            Library::new(()).action("work", |a: Action<()>| async move {
                STARTED.fetch_add(1, Ordering::Relaxed);
                a.cx().sleep(Duration::from_secs(2)).await;
                Ok(())
            })
        });
        register_script(&mut registry, look);
        let kill = Fault::on("on_n", FaultKind::Kill, Instant::from_nanos(1_500_000_000));
        STARTED.store(0, Ordering::Relaxed);
        let found = simulate(app, registry, Faults::of_script("a death", vec![kill])).0;
        (found.unwrap(), STARTED.load(Ordering::Relaxed))
    };
    let (found, started) = run(text(""));
    assert_eq!(started, 1, "{found}");
    assert!(
        found.starts_with("a 0 b 0 [\"t\"] transition `t` is in doubt"),
        "{found}"
    );
    let (found, started) = run(text("  idempotent\n"));
    assert_eq!((found.as_str(), started), ("a 0 b 1 [] ", 2));
}

#[test]
fn a_durable_net_refuses_the_state_of_another_net_and_says_what_to_do() {
    async fn wait(cx: Context) -> Result<String, HandlerError> {
        cx.sleep(Duration::from_secs(20)).await;
        Ok(String::new())
    }
    let lives = Arc::new(Mutex::new(0));
    let errors: Arc<Mutex<Vec<String>>> = Arc::default();
    let app = durable_app(&[("n", "durable = true")], 1);
    let mut registry = Registry::new();
    let (count, kept) = (lives, errors.clone());
    registry.handler("n", &COMMANDS, move |cx| {
        let mut count = count.lock().unwrap();
        *count += 1;
        let text = if *count == 1 {
            N.to_owned()
        } else {
            N.replace("times", "tries")
        };
        let net = compile::net(&Source::new("n.net", text)).unwrap();
        let settings = settings(cx.config().unwrap())?;
        let library = working(Duration::from_millis(1));
        let built = NetTask::with_settings(cx, net, library, None, settings);
        built.inspect_err(|error| kept.lock().unwrap().push(error.to_string()))
    });
    registry.handler("operator", &[], |_| {
        Ok(Scripted(Rc::new(|cx| {
            Box::pin(async move {
                let to = cx.task("n").await?;
                let put = PutTape {
                    symbol: "go".to_owned(),
                    arguments: Vec::new(),
                };
                cx.call(&to, put).await?;
                wait(cx).await
            })
        })))
    });
    let kill = Fault::on("on_n", FaultKind::Kill, Instant::from_nanos(3_000_000_000));
    let _ = simulate(app, registry, Faults::of_script("a death", vec![kill]));
    let errors = errors.lock().unwrap();
    let error = errors.first().unwrap();
    assert!(
        error.contains("n.redb: it holds the state of another net called `n`")
            && error.contains("or move the file away"),
        "{error}"
    );
}
