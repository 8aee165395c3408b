//! What a `request` line costs over a compiled function that asks the same, and what a guard of declared data costs.
//! Both nets run in the same process, one after the other, beside a daemon in the same chassis.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a benchmark may end when its input is wrong, and tells what it measured"
)]

use std::{hint::black_box, sync::Arc, time::Duration};

use ctos::{
    boot::{End, Observer},
    config::load,
    registry::Registry,
    simulation::{self, Setup},
    system::AppResult,
    task::{Context, Handled, Phase},
    time::Clock,
};
use pnt::{
    compile,
    expression::Values,
    library::{Action, Library},
    task::{PutTape, register as register_net},
};
use sorma::{
    Dictionary, Request, Sorm,
    daemon::{self, Tasks},
};

/// Requests of one run.
const REQUESTS: u32 = 2000;

const WRITTEN: &str = "net n
place idle = 1, asking
data left : int
data x : float = 0.25
command go(times : int) -> gone
transition begin
  in idle
  tape go
  set left = times
  out asking
transition ask
  in asking
  when left > 0
  request \"bar CTRL -tea $x\"
  set left = left - 1
  out asking
transition finish
  in asking
  when not left > 0
  out idle
  write gone
";

const COMPILED: &str = "net n
place idle = 1, asking
command go -> gone
transition begin
  in idle
  tape go
  do begin
  out asking
transition ask
  in asking
  when more
  do ask
  out asking
transition finish
  in asking
  when not more
  out idle
  write gone
";

/// What the compiled functions share.
struct Left {
    left: u32,
    x: f64,
    sorm: Sorm,
}

fn compiled() -> Library<Left> {
    let sorm = Sorm::new(Dictionary::new());
    let left = Left {
        left: 0,
        x: 0.25,
        sorm,
    };
    Library::new(left)
        .enabling("more", |left| left.left > 0)
        .action("begin", |action: Action<Left>| async move {
            action.with_state(|left| left.left = REQUESTS);
            Ok(())
        })
        .action("ask", |action: Action<Left>| async move {
            let (line, sorm) = action.with_state(|left| {
                left.left -= 1;
                (
                    format!("bar@objects CTRL -tea {}", left.x),
                    left.sorm.clone(),
                )
            });
            let request: Request = line.parse()?;
            let reply = sorm.ask(&Tasks::of(action.cx()), request).await;
            assert!(reply.body.is_ok(), "{}", reply.body.said());
            Ok(())
        })
}

/// Puts one command, if it asks, and ends the app with its answer.
struct Person {
    asks: bool,
}

#[ctos::handler]
impl Person {
    #[phase]
    async fn enters(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let cx = cx.clone();
            if !self.asks {
                let (text, json) = ("gone".to_owned(), String::new());
                cx.finish(AppResult {
                    ok: true,
                    text,
                    json,
                });
                return Ok(());
            }
            cx.clone().spawn(async move {
                let put = PutTape {
                    symbol: "go".to_owned(),
                    arguments: vec![REQUESTS.to_string()],
                };
                let net = cx.wait_for_task("n", Duration::from_secs(9)).await;
                let text = match net {
                    Ok(net) => match cx.call(&net, put).await {
                        Ok(answer) => answer.symbol,
                        Err(error) => error.to_string(),
                    },
                    Err(error) => error.to_string(),
                };
                let json = String::new();
                cx.finish(AppResult {
                    ok: true,
                    text,
                    json,
                });
            });
        }
        Ok(())
    }
}

/// How long an app takes from its start to its end, s. The file of each of these nets is there, and the first has the
/// handler of that name.
fn app(nets: &[(String, String)], handler: &str, person: bool) -> f64 {
    let folder = tempfile::tempdir().unwrap();
    let mut config = "[app]\nuntil = \"person\"\n[time]\nmode = \"virtual\"\n[chassis.a]\n[task.person]\nhandler = \"person\"\non = \"a\"\n[task.objects]\nhandler = \"sorma.daemon\"\non = \"a\"\n".to_owned();
    for (name, text) in nets {
        let file = format!("{name}.net");
        std::fs::write(folder.path().join(&file), text).unwrap();
        config +=
            &format!("[task.{name}]\nhandler = \"{handler}\"\non = \"a\"\nargs.net = \"{file}\"\n");
    }
    std::fs::write(folder.path().join("app.toml"), config).unwrap();
    let app = load(&folder.path().join("app.toml"), &[], &[]).unwrap();
    let mut registry = Registry::new();
    pnt_net::register(&mut registry);
    register_net(&mut registry, "compiled.net", compiled);
    daemon::register(&mut registry, Dictionary::new(), |_, sorm| {
        sorma::demo::register(sorm);
    });
    registry.handler("person", &[], move |_| Ok(Person { asks: person }));
    let unseen: Observer = Arc::new(|_| ());
    let clock = Clock::real();
    let begun = clock.now();
    let ran = simulation::run(app, registry, Setup::default(), &unseen).unwrap();
    let took = clock.now().since(begun);
    match ran.outcome.end {
        End::Finished(result) => assert_eq!(result.text, "gone"),
        other => panic!("{other:?}"),
    }
    took.as_secs_f64()
}

/// What one request takes, us.
fn request(handler: &str, text: &str) -> f64 {
    app(&[("n".to_owned(), text.to_owned())], handler, true) * 1e6 / f64::from(REQUESTS)
}

/// What it takes to start an app of so many nets, s.
fn start(count: usize) -> f64 {
    let net = |index: usize| {
        let name = format!("n{index}");
        let text = WRITTEN.replace("net n", &format!("net {name}"));
        (name, text)
    };
    let nets: Vec<(String, String)> = (0..count).map(net).collect();
    app(&nets, "pnt.net", false)
}

/// What a guard takes, us.
fn guard() -> f64 {
    let text = "net n\nplace p = 1\ndata count : int = 3\ndata positions : int = 9\ndata spot { u : px, v : px, sd : px }\ntransition t\n  in p\n  when count < positions && spot.sd < 0.2\n  out p\n";
    let net = compile::net(&ctos::diagnostic::Source::new("n.net", text)).unwrap();
    let values = net.declared().initial();
    let values = Values {
        declared: net.declared(),
        values: &values,
        arguments: &[],
    };
    let guard = net
        .transitions()
        .iter()
        .find_map(|one| one.when.as_ref()?.expression.as_ref())
        .unwrap();
    let clock = Clock::real();
    let begun = clock.now();
    let times = 100_000;
    for _ in 0..times {
        black_box(guard.evaluate(black_box(&values)).unwrap());
    }
    clock.now().since(begun).as_secs_f64() * 1e6 / f64::from(times)
}

fn main() {
    // Of several runs the quickest: whatever else the machine does only adds to it.
    let least = |of: &dyn Fn() -> f64| (0..5).map(|_| of()).fold(f64::INFINITY, f64::min);
    let written = least(&|| request("pnt.net", WRITTEN));
    let compiled = least(&|| request("compiled.net", COMPILED));
    println!("guard            {:8.3} us", least(&guard));
    println!("request, text    {written:8.3} us");
    println!("request, code    {compiled:8.3} us");
    println!(
        "text over code   {:8.3} us, ratio {:.2}",
        written - compiled,
        written / compiled
    );
    println!(
        "start, 1000 nets {:8.3} s",
        (0..3).map(|_| start(1000)).fold(f64::INFINITY, f64::min)
    );
}
