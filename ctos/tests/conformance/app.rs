//! The app of every trial: the task that runs the case, and those it plays with, near it and far.

use std::ops::Range;

use ctos::{
    config::{App, load_texts},
    registry::Registry,
};

use crate::{cases, peer};

/// Where the far tasks live, seen from the near ones.
pub struct Placement {
    pub name: &'static str,
    mode: &'static str,
    near: &'static str,
    far: &'static str,
    pub seeds: Range<u64>,
}

impl Placement {
    pub const ALL: [Self; 5] = [
        Self {
            name: "same_processor",
            mode: "real",
            near: "a/main",
            far: "a/main",
            seeds: 1..2,
        },
        Self {
            name: "two_processors",
            mode: "real",
            near: "a/main",
            far: "a/second",
            seeds: 1..2,
        },
        Self {
            name: "two_chassis_tcp",
            mode: "real",
            near: "a/main",
            far: "b/main",
            seeds: 1..2,
        },
        Self {
            name: "two_processors_virtual",
            mode: "virtual",
            near: "a/main",
            far: "a/second",
            seeds: 1..9,
        },
        Self {
            name: "two_chassis_virtual",
            mode: "virtual",
            near: "a/main",
            far: "b/main",
            seeds: 1..9,
        },
    ];

    pub fn app(&self, seed: u64, case: &str) -> App {
        let Self {
            mode, near, far, ..
        } = self;
        let second = if far.starts_with('b') {
            "[chassis.b]"
        } else {
            ""
        };
        let text = format!(
            r#"
            [app]
            seed = {seed}
            until = "driver"
            [time]
            mode = "{mode}"
            [chassis.a]
            processors.main = {{}}
            processors.second = {{}}
            {second}
            [task.driver]
            handler = "suite.driver"
            on = "{near}"
            args.case = "{case}"
            [task.near]
            handler = "suite.peer"
            on = "{near}"
            queue = 4
            [task.near_sender]
            handler = "suite.peer"
            on = "{near}"
            [task.peer]
            handler = "suite.peer"
            on = "{far}"
            queue = 4
            restart = "always"
            [task.roamer]
            handler = "suite.roamer"
            on = "{far}"
            queue = 4
            [task.far_sender]
            handler = "suite.peer"
            on = "{far}"
            [task.gate]
            handler = "suite.gate"
            on = "{far}"
            "#
        );
        load_texts(&[("conformance.toml", &text)], &[], &[]).unwrap()
    }
}

pub fn registry() -> Registry {
    let mut registry = Registry::new();
    peer::register(&mut registry);
    cases::register(&mut registry);
    registry
}
