//! CTOS as a contender.

use bench::Bench;
use ctos::{
    config::load_texts,
    message::{Command, Message},
    registry::Registry,
    task::{Context, EventHandler, Handled, TaskRef},
};

use crate::contenders::{Data, Pair, WINDOW};

ctos::command! {
    /// Answers with one number.
    pub struct Ask { pub data: Data } => u64, 1, "ask"
}
ctos::command! {
    /// Is taken, and that is all.
    pub struct Tell { pub data: Data } => (), 2, "tell"
}

struct Far;

impl EventHandler for Far {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Ask::CODE => {
                let (Ask { data }, reply) = message.open::<Ask>()?;
                reply.ok(data[0])
            }
            Tell::CODE => {
                let (Tell { data }, reply) = message.open::<Tell>()?;
                std::hint::black_box(data);
                reply.ok(())
            }
            _ => cx.default_processing(message),
        }
    }
}

/// A chassis with these processors, by their tables in the configuration.
pub fn bench(processors: &[&str]) -> Bench {
    let mut text = String::from("[task.none]\nhandler = \"far\"\non = \"a/p1\"\n[chassis.a]\n");
    for (index, table) in processors.iter().enumerate() {
        text.push_str(&format!("processors.p{} = {{ {table} }}\n", index + 1));
    }
    let app = load_texts(&[("peers.toml", &text)], &[], &[]).expect("a good configuration");
    let mut registry = Registry::new();
    registry.handler("far", &[Ask::INFO, Tell::INFO], |_| Ok(Far));
    Bench::start(app, registry).expect("threads")
}

/// The task on one processor, its caller on another one or the same.
pub struct Ctos {
    bench: Bench,
    far: TaskRef,
    near: u8,
}

impl Ctos {
    pub fn new(processors: &[&str]) -> Self {
        let bench = bench(processors);
        let near = if processors.len() > 1 { 2 } else { 1 };
        let mut far = bench.tasks("far", 1, 0, 1).ok().expect("a task");
        Self {
            far: far.remove(0),
            bench,
            near,
        }
    }
}

impl Pair for Ctos {
    fn calls(&mut self, count: u32) {
        let far = self.far.clone();
        let work = move |cx: Context| async move {
            let data = Data::default();
            for _ in 0..count {
                cx.call(&far, Ask { data }).await.expect("an answer");
            }
        };
        self.bench.run(self.near, work).ok().expect("it runs");
    }
}

/// One task that several processors send to.
pub struct CtosOneWay {
    bench: Bench,
    far: TaskRef,
    producers: u8,
}

impl CtosOneWay {
    pub fn new(producers: u8) -> Self {
        let processors = vec![""; usize::from(producers) + 1];
        let bench = bench(&processors);
        let mut far = bench.tasks("far", 1, 0, 1).ok().expect("a task");
        Self {
            far: far.remove(0),
            bench,
            producers,
        }
    }

    pub fn send(&mut self, count: u32) {
        let each = count / u32::from(self.producers);
        let ends: Vec<_> = (0..self.producers)
            .map(|producer| {
                let far = self.far.clone();
                let work = move |cx: Context| async move {
                    let data = Data::default();
                    for _ in 0..each {
                        cx.send(&far, Tell { data }).await.expect("room");
                    }
                    // What was sent has been handled when this is answered.
                    cx.call(&far, Ask { data }).await.expect("an answer");
                };
                self.bench.begin(producer + 2, work).ok().expect("it runs")
            })
            .collect();
        for end in ends {
            end.recv().expect("it ends");
        }
    }
}

/// Idle tasks on two processors.
pub struct CtosIdle {
    bench: Bench,
    tasks: Vec<Vec<TaskRef>>,
}

impl CtosIdle {
    pub fn new() -> Self {
        Self {
            bench: bench(&["", ""]),
            tasks: Vec::new(),
        }
    }

    pub fn spawn(&mut self, count: u32) {
        let half = count / 2;
        for processor in [1, 2] {
            let tasks = self.bench.tasks("far", processor, 0, half);
            self.tasks.push(tasks.ok().expect("they start"));
        }
    }

    pub fn ask_all(&mut self) {
        let tasks = self.tasks.iter().flatten().take(WINDOW);
        let tasks: Vec<TaskRef> = tasks.cloned().collect();
        let work = move |cx: Context| async move {
            let data = Data::default();
            for task in &tasks {
                cx.call(task, Ask { data }).await.expect("an answer");
            }
        };
        self.bench.run(1, work).ok().expect("it runs");
    }
}
