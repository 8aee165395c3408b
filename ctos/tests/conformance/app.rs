//! The app of every trial: the task that runs the case, and those it plays with, local and remote.

use std::ops::Range;

use ctos::{
    config::{App, load_texts},
    registry::Registry,
};

use crate::{cases, peer};

/// The folder of the keys that some placements need.
pub const KEYS: &str = concat!(env!("CARGO_TARGET_TMPDIR"), "/conformance-keys");

/// Where the remote tasks live, seen from the local ones.
pub struct Placement {
    pub name: &'static str,
    mode: &'static str,
    /// What the configuration says of links.
    links: &'static [&'static str],
    near: &'static str,
    far: &'static str,
    pub seeds: Range<u64>,
}

impl Placement {
    pub const ALL: &[Self] = &[
        Self {
            name: "same_processor",
            mode: "real",
            links: &[],
            near: "a/main",
            far: "a/main",
            seeds: 1..2,
        },
        Self {
            name: "two_processors",
            mode: "real",
            links: &[],
            near: "a/main",
            far: "a/second",
            seeds: 1..2,
        },
        Self {
            name: "two_chassis_shm",
            mode: "real",
            links: &["same_host=shm"],
            near: "a/main",
            far: "b/main",
            seeds: 1..2,
        },
        Self {
            name: "two_chassis_unix",
            mode: "real",
            links: &["same_host=unix"],
            near: "a/main",
            far: "b/main",
            seeds: 1..2,
        },
        Self {
            name: "two_chassis_tcp",
            mode: "real",
            links: &["same_host=tcp"],
            near: "a/main",
            far: "b/main",
            seeds: 1..2,
        },
        Self {
            name: "two_chassis_tls",
            mode: "real",
            links: &[
                "same_host=tcp",
                r#"security={ key = "KEYS/cell", authority = "KEYS/ca.pem" }"#,
            ],
            near: "a/main",
            far: "b/main",
            seeds: 1..2,
        },
        Self {
            name: "two_chassis_tcp_breaking",
            mode: "real",
            links: &[
                "same_host=tcp",
                "injure.break_bytes=2000",
                "injure.drop=0.02",
            ],
            near: "a/main",
            far: "b/main",
            seeds: 1..2,
        },
        #[cfg(feature = "zenoh")]
        Self {
            name: "two_chassis_zenoh",
            mode: "real",
            links: &["same_host=zenoh", "zenoh.mode=router"],
            near: "a/main",
            far: "b/main",
            seeds: 1..2,
        },
        #[cfg(feature = "zenoh")]
        Self {
            name: "two_chassis_zenoh_tls_breaking",
            mode: "real",
            links: &[
                "same_host=zenoh",
                "zenoh.mode=router",
                "injure.break_bytes=20000",
                "injure.drop=0.02",
                r#"security={ key = "KEYS/cell", authority = "KEYS/ca.pem" }"#,
            ],
            near: "a/main",
            far: "b/main",
            seeds: 1..2,
        },
        Self {
            name: "same_processor_virtual",
            mode: "virtual",
            links: &[],
            near: "a/main",
            far: "a/main",
            seeds: 1..9,
        },
        Self {
            name: "two_processors_virtual",
            mode: "virtual",
            links: &[],
            near: "a/main",
            far: "a/second",
            seeds: 1..9,
        },
        Self {
            name: "two_chassis_virtual",
            mode: "virtual",
            links: &[],
            near: "a/main",
            far: "b/main",
            seeds: 1..9,
        },
    ];

    /// What each run of it has for itself: where its zenoh network is.
    pub fn own_sets(&self) -> Vec<String> {
        if !self.links.contains(&"zenoh.mode=router") {
            return Vec::new();
        }
        let listener = std::net::TcpListener::bind(("127.0.0.1", 0)).unwrap();
        let address = listener.local_addr().unwrap();
        vec![format!("zenoh.listen=[\"tcp/{address}\"]")]
    }

    pub fn app(&self, seed: u64, case: &str, more: &[&str]) -> App {
        let Self {
            mode,
            links,
            near,
            far,
            ..
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
        let sets = links
            .iter()
            .chain(more)
            .map(|set| set.replace("KEYS", KEYS));
        let sets: Vec<String> = sets.collect();
        load_texts(&[("conformance.toml", &text)], &sets, &[]).unwrap()
    }
}

pub fn registry() -> Registry {
    let mut registry = Registry::new();
    peer::register(&mut registry);
    cases::register(&mut registry);
    registry
}
