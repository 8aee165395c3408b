//! An app of a client and a few daemons, each on a chassis of its own, in virtual time. Also the classes
//! that its processes know.

use ctos::boot::{BootEvent, End, Fault, FaultKind, Observer, simulate};
use ctos::config::load_texts;
use ctos::registry::Registry;
use ctos::system::AppResult;
use ctos::task::{Context as TaskContext, Handled, Phase};
use ctos::time::Instant;
use futures_util::future::LocalBoxFuture;
use sorma::daemon::{self, Tasks};
use sorma::report::code;
use sorma::{
    Class, Context, Dictionary, Method, OptionTable, Outcome, Report, Request, ServiceObject, Sorm,
    Transport, Waiting, raise,
};
use std::sync::{Arc, LazyLock, Mutex};
use std::time::Duration;

#[derive(Debug, Clone)]
struct Scale {
    factor: f64,
}

impl Default for Scale {
    fn default() -> Self {
        Self { factor: 1.0 }
    }
}

static SCALE: LazyLock<OptionTable<Scale>> = LazyLock::new(|| {
    OptionTable::new("multiplies what it is given").float(
        "factor",
        -10.0..=10.0,
        "",
        "by how much",
        |scale: &mut Scale| &mut scale.factor,
    )
});

impl ServiceObject for Scale {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        if io.floats.is_empty() {
            return Err(raise!(code::VALUE, "takes at least one float"));
        }
        if io.text == "burn" {
            panic!("it burns");
        }
        if self.factor < 0.0 {
            io.report(Report::warning(101, "turns the sign"));
        }
        for float in &mut io.floats {
            *float *= self.factor;
        }
        io.opaque.to_mut().reverse();
        Ok(())
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        SCALE.ctrl(self, io);
        Ok(())
    }

    fn dump(&self) -> String {
        SCALE.dump(self)
    }
}

/// Asks two others, wherever they are.
#[derive(Debug, Clone, Default)]
struct Chain {
    first: String,
    second: String,
}

static CHAIN: LazyLock<OptionTable<Chain>> = LazyLock::new(|| {
    OptionTable::new("has two objects work one after the other")
        .word("first", "OBJECT", "who begins", |chain: &mut Chain| {
            &mut chain.first
        })
        .word("second", "OBJECT", "who ends", |chain| &mut chain.second)
});

impl ServiceObject for Chain {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        io: &'a mut Transport,
    ) -> Option<LocalBoxFuture<'a, Outcome>> {
        Some(Box::pin(async move {
            for name in [&self.first, &self.second] {
                let sub = Transport::floats(io.floats.clone());
                io.floats = cx.call(name, Method::Exec, sub, io).await?.floats;
            }
            Ok(())
        }))
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        CHAIN.ctrl(self, io);
        Ok(())
    }

    fn dump(&self) -> String {
        CHAIN.dump(self)
    }
}

/// Counts its EXECs, and says so when its state is changed.
struct Count(i64);

impl ServiceObject for Count {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        if io.text == "fail" {
            return Err(raise!(code::VALUE, "as you wish"));
        }
        self.0 += 1;
        io.ints = vec![self.0];
        Ok(())
    }

    fn ctrl(&mut self, cx: &Context<'_>, io: &mut Transport) -> Outcome {
        self.0 = 0;
        io.text.clear();
        cx.publish(&Transport::text("it begins anew"));
        Ok(())
    }

    fn dump(&self) -> String {
        self.0.to_string()
    }
}

/// Takes its time, s.
struct Nap(f64);

impl ServiceObject for Nap {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        _io: &'a mut Transport,
    ) -> Option<LocalBoxFuture<'a, Outcome>> {
        Some(Box::pin(async move {
            cx.sleep(seconds(self.0)).await;
            Ok(())
        }))
    }

    fn ctrl(&mut self, _cx: &Context<'_>, _io: &mut Transport) -> Outcome {
        Ok(())
    }

    fn dump(&self) -> String {
        String::new()
    }
}

/// Registers the classes.
pub fn classes(sorm: &Sorm) {
    sorma::asynchronous::register(sorm);
    sorm.register(Class::new("count", "1.0", |_, _| Ok(Box::new(Count(0)))));
    sorm.register(Class::new("nap", "1.0", |_, _| Ok(Box::new(Nap(5.0)))).waits());
    sorm.register(Class::new("doze", "1.0", |_, _| Ok(Box::new(Nap(200.0)))).waits());
    sorm.register(Class::new("scale", "1.0", |_, _| {
        Ok(Box::new(Scale::default()))
    }));
    let chain = Class::new("chain", "1.0", |_, _| Ok(Box::new(Chain::default())));
    sorm.register(chain.waits());
}

/// What all processes cook from.
pub const COOKBOOK: &str = "scale.two -factor 2\nscale.minus -factor -1\n\
    chain.a -first scale.two -second scale.minus\nchain.loop -first chain.loop -second scale.two\n\
    stream.count -from count@d1\nstream.text -from event@d1\nstream.scale -from event@d1 -to scale.two\n";

/// What a client does; its text, or what went wrong, is the result of the test.
pub type Scenario = fn(TaskContext, Sorm) -> LocalBoxFuture<'static, Result<String, String>>;

/// A client, on another chassis than the daemons, that goes through a scenario.
struct Client {
    scenario: Scenario,
    sorm: Sorm,
}

#[ctos::handler]
impl Client {
    #[phase]
    async fn phase(&mut self, cx: &TaskContext, phase: Phase) -> Handled {
        if phase != Phase::Run {
            return Ok(());
        }
        let (here, sorm, scenario) = (cx.clone(), self.sorm.clone(), self.scenario);
        cx.spawn(async move {
            let (ok, text) = match scenario(here.clone(), sorm).await {
                Ok(text) => (true, text),
                Err(text) => (false, text),
            };
            let json = String::new();
            here.finish(AppResult { ok, text, json });
        });
        Ok(())
    }

    #[chassis_up]
    async fn chassis_up(&mut self, cx: &TaskContext, chassis: &str) -> Handled {
        daemon::rebuild(&self.sorm, cx, chassis).await;
        Ok(())
    }
}

/// What a test is about.
pub struct App {
    pub scenario: Scenario,
    /// What the client's dictionary has besides the cookbook.
    pub here: &'static str,
    /// Tasks with their chassis and further lines of their configuration.
    pub daemons: Vec<(&'static str, &'static str, &'static str)>,
    pub faults: Vec<Fault>,
    /// Further handlers.
    pub handlers: fn(&mut Registry),
    pub seed: u64,
    /// Chassis that start when somebody looks for one of their tasks.
    pub on_demand: &'static [&'static str],
    /// What the daemons serve besides what every daemon does.
    pub classes: fn(&Sorm),
}

impl App {
    /// One daemon, `d1` on `cage`, and nothing happens.
    pub fn new(scenario: Scenario) -> Self {
        Self {
            scenario,
            here: "",
            daemons: vec![("d1", "cage", "")],
            faults: Vec::new(),
            handlers: |_| {},
            seed: 1,
            on_demand: &[],
            classes,
        }
    }

    pub fn run(self) -> Result<String, String> {
        self.run_seen().0
    }

    /// [`Self::run`], and what happened.
    pub fn run_seen(self) -> (Result<String, String>, Vec<BootEvent>) {
        let folder = tempfile::tempdir().unwrap();
        let book = folder.path().join("cook.dict");
        std::fs::write(&book, COOKBOOK).unwrap();
        let mut app = format!(
            "app.until = \"client\"\napp.seed = {}\n[chassis.desk]\n\
             [task.client]\nhandler = \"client\"\non = \"desk\"\n",
            self.seed
        );
        for (task, chassis, lines) in &self.daemons {
            let handler = match lines.contains("handler") {
                true => String::new(),
                false => format!(
                    "handler = \"sorma.daemon\"\nargs.dictionary = [{:?}]\n",
                    book.display().to_string()
                ),
            };
            let start = match self.on_demand.contains(chassis) {
                true => "start = \"on-demand\"\n",
                false => "",
            };
            app += &format!(
                "[chassis.{chassis}]\n{start}restart = \"on-failure\"\nmax_restarts = 100\n\
                 [task.{task}]\non = \"{chassis}\"\n{handler}{lines}\n"
            );
        }
        let app = load_texts(&[("app.toml", &app)], &[], &[]).unwrap();
        let mut registry = Registry::new();
        let served = self.classes;
        daemon::register(&mut registry, Dictionary::new(), move |_, sorm| {
            served(sorm)
        });
        (self.handlers)(&mut registry);
        let (scenario, here) = (self.scenario, self.here);
        registry.handler("client", &Client::COMMANDS, move |cx| {
            let mut dictionary = Dictionary::new();
            for text in [COOKBOOK, here] {
                let source = ctos::diagnostic::Source::new("cookbook", text);
                dictionary.load(&source).unwrap();
            }
            let chassis = cx.chassis();
            let sorm = Sorm::of(chassis.name(), chassis.clock().clone(), dictionary);
            classes(&sorm);
            Ok(Client { scenario, sorm })
        });
        let seen: Arc<Mutex<Vec<BootEvent>>> = Arc::default();
        let sees = Arc::clone(&seen);
        let observer: Observer = Arc::new(move |event: &BootEvent| {
            sees.lock().unwrap().push(event.clone());
        });
        let outcome = simulate(app, registry, &self.faults, &observer).unwrap();
        let seen = seen.lock().unwrap().clone();
        let result = match outcome.end {
            End::Finished(result) if result.ok => Ok(result.text),
            End::Finished(result) => Err(result.text),
            other => Err(format!("{other:?}")),
        };
        (result, seen)
    }
}

/// Asks by one line.
pub async fn ask(sorm: &Sorm, cx: &TaskContext, line: &str) -> sorma::Reply {
    sorm.ask(&Tasks::of(cx), request(line)).await
}

pub fn request(line: &str) -> Request {
    line.parse().unwrap()
}

pub fn seconds(seconds: f64) -> Duration {
    Duration::from_secs_f64(seconds)
}

/// The process of a chassis ends.
pub fn kill(chassis: &str, at_s: f64) -> Fault {
    Fault::on(
        chassis.to_owned(),
        FaultKind::Kill,
        Instant::START + seconds(at_s),
    )
}
