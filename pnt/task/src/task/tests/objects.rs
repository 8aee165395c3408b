//! Data objects of actions: several that are sent along, and several that store a reply or a result. In one
//! chassis, over a link, and when the net dies at any moment.

use std::{collections::BTreeMap, sync::Mutex};

use ctos::{
    message::Data,
    simulation::{Fault, FaultKind, Faults},
    time::Instant,
};
use serde::{Deserialize, Serialize};

use super::{
    survival::{insist, register_script, simulate, tokens},
    *,
};

/// What a camera has seen.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Seen {
    name: String,
    at_m: [f64; 2],
    sure: Option<u32>,
}

ctos::command! {
    /// Looks from somewhere.
    struct Look { from: String, far_m: f64 } => Seen, 0x0001, "look"
}

const NET: &str = "net n
place free = 1, asked, seen data at, turned data left
command go -> gone
transition begin
  in free
  tape go
  do begin
  idempotent
  out asked
transition look
  in asked
  send camera.look(from, far -> name, at, sure)
  idempotent
  out seen
transition turn
  in seen
  do turn(at, sure -> left, right)
  idempotent
  out turned
transition end
  in turned
  out free
  write gone
";

/// An object that no store takes.
const REFUSED: &str = "refused";

/// A store of data objects that outlives every chassis.
#[derive(Clone, Default)]
struct Objects(Arc<Mutex<BTreeMap<String, Vec<u8>>>>);

impl DataStore for Objects {
    fn get(&self, _cx: &Context, object: &str) -> Later<Result<Vec<u8>, HandlerError>> {
        let found = self.0.lock().unwrap().get(object).cloned();
        Box::pin(async move { found.ok_or_else(|| HandlerError::new("no such object")) })
    }

    fn put(&self, _cx: &Context, objects: Vec<(String, Vec<u8>)>) -> Later<Handled> {
        let refused = objects.iter().find(|(object, _)| object == REFUSED);
        if let Some((object, _)) = refused {
            let why = HandlerError::new(format!("there is no room for `{object}`"));
            return Box::pin(async move { Err(why) });
        }
        self.0.lock().unwrap().extend(objects);
        Box::pin(async { Ok(()) })
    }

    fn validity(&self, _cx: &Context, _object: &str, _valid: bool) -> Later<Handled> {
        Box::pin(async { Ok(()) })
    }
}

impl Objects {
    fn of<T: serde::de::DeserializeOwned + 'static>(&self, object: &str) -> T {
        let bytes = self.0.lock().unwrap()[object].clone();
        Data::Bytes(bytes).take().unwrap()
    }
}

fn library() -> Library<()> {
    Library::new(())
        .action("begin", |a: Action<()>| async move {
            let from = Data::of("the left".to_owned()).into_bytes()?;
            a.put_data("from", from).await?;
            a.put_data("far", Data::of(1.5_f64).into_bytes()?).await
        })
        .function(
            "turn",
            |a: Action<()>, (at_m, sure): ([f64; 2], Option<u32>)| async move {
                a.cx().sleep(Duration::from_millis(40)).await;
                Ok((sure.unwrap_or(0) + 1, [-at_m[1], at_m[0]]))
            },
        )
}

async fn go(cx: Context) -> Result<String, HandlerError> {
    let put = PutOnce {
        request: RequestId {
            from: "operator".to_owned(),
            number: 1,
        },
        symbol: "go".to_owned(),
        arguments: Vec::new(),
    };
    let answer = put_once(&cx, "n", &put, Duration::from_secs(600)).await?;
    let snapshot = insist(&cx, "n", Marking {}).await?;
    Ok(format!(
        "{} free {}",
        answer.symbol,
        tokens(&snapshot, "free")
    ))
}

/// Runs the net and the camera where they are told, and looks at what is in the objects then.
fn run_net(camera_on: &str, more: &str, faults: Faults, what: &str) {
    let text = format!(
        "[app]\nname = \"t\"\nuntil = \"operator\"\n[time]\nmode = \"virtual\"\n[chassis.desk]\n[chassis.eye]\n[chassis.home]\nrestart = \"always\"\nmax_restarts = 100\nrestart_backoff_s = 0.05\n[task.operator]\nhandler = \"operator\"\non = \"desk\"\n[task.n]\nhandler = \"n\"\non = \"home\"\nargs = {{ net = \"n.net\", {more} }}\n[task.camera]\nhandler = \"camera\"\non = \"{camera_on}\"\n"
    );
    let app = config::load_texts(&[("app.toml", &text)], &[], &[]).unwrap();
    let net = compile::net(&Source::new("n.net", NET)).unwrap_or_else(|f| panic!("{f}"));
    let objects = Objects::default();
    let kept = objects.clone();
    let mut registry = Registry::new();
    registry.handler("n", &COMMANDS, move |cx| {
        let settings = settings(cx.config().unwrap())?;
        NetTask::with_settings(
            cx,
            net.clone(),
            library(),
            Some(Rc::new(kept.clone())),
            settings,
        )
    });
    registry.function::<Look, _, _>("camera", |cx, look| async move {
        cx.sleep(Duration::from_millis(60)).await;
        Ok(Seen {
            name: format!("lamp from {}", look.from),
            at_m: [look.far_m, 2.0],
            sure: Some(300),
        })
    });
    register_script(&mut registry, go);
    let found = simulate(app, registry, faults).0;
    assert_eq!(found.as_deref(), Ok("gone free 1"), "{what}");
    assert_eq!(objects.of::<String>("name"), "lamp from the left", "{what}");
    assert_eq!(objects.of::<[f64; 2]>("at"), [1.5, 2.0], "{what}");
    assert_eq!(objects.of::<Option<u32>>("sure"), Some(300), "{what}");
    assert_eq!(objects.of::<u32>("left"), 301, "{what}");
    assert_eq!(objects.of::<[f64; 2]>("right"), [-2.0, 1.5], "{what}");
}

#[test]
fn each_field_of_a_reply_and_of_a_result_is_put_back_as_an_object() {
    run_net("home", "", Faults::none(), "in one chassis");
    run_net("eye", "", Faults::none(), "over a link");
    run_net("eye", "durable = true", Faults::none(), "durable");
}

#[test]
fn the_objects_of_a_durable_net_are_the_same_whenever_it_dies() {
    for step in 0..30_u64 {
        let kill = Fault::on(
            "home",
            FaultKind::Kill,
            Instant::from_nanos(1_000_000 + step * 4_000_000),
        );
        let script = Faults::of_script("a death", vec![kill]);
        run_net("eye", "durable = true", script, &format!("step {step}"));
    }
}

/// Works on `number` once and stores the results as `low` and as an object called `high`; what became of
/// the command, and the objects then.
fn worked(number: &impl Serialize, high: &str) -> (String, BTreeMap<String, Vec<u8>>) {
    let text = format!(
        "net n
place free = 1, done, lost
command go -> gone, lost
transition work
  in free
  tape go
  do half(number -> low, {high})
  out done
  fail lost
transition end
  in done
  out free
  write gone
transition give_up
  in lost
  out free
  write lost
"
    );
    let net = compile::net(&Source::new("n.net", text)).unwrap_or_else(|f| panic!("{f}"));
    let objects = Objects::default();
    let bytes = postcard::to_stdvec(number).unwrap();
    objects.0.lock().unwrap().insert("number".to_owned(), bytes);
    let kept = objects.clone();
    let mut registry = Registry::new();
    register_operator(&mut registry, "n", &["go"]);
    registry.handler("n", &COMMANDS, move |cx| {
        let library = Library::new(()).function("half", |_, number: u32| async move {
            Ok((number / 2, number - number / 2))
        });
        let store = Rc::new(kept.clone());
        let rule = Conflicts::Declared;
        Ok(NetTask::new(cx, net.clone(), library, rule, Some(store)))
    });
    let said = run(app(&[("operator", "a"), ("n", "b")], 1), registry).unwrap();
    let objects = objects.0.lock().unwrap().clone();
    (said, objects)
}

#[test]
fn an_argument_that_is_not_what_a_function_takes_fails_its_action_and_stores_nothing() {
    let (said, objects) = worked(&"no number", "high");
    assert!(
        said.starts_with("answer lost [work: data is not a u32: "),
        "{said}"
    );
    assert!(!objects.contains_key("low") && !objects.contains_key("high"));
}

#[test]
fn of_several_results_none_is_stored_when_the_store_refuses_one() {
    let (said, objects) = worked(&9_u32, "high");
    assert!(said.starts_with("answer gone"), "{said}");
    assert!(objects.contains_key("low") && objects.contains_key("high"));
    let (said, objects) = worked(&9_u32, REFUSED);
    let told = "answer lost [work: there is no room for `refused`]";
    assert!(said.starts_with(told), "{said}");
    assert!(!objects.contains_key("low"), "the first of them was stored");
}
