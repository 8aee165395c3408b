//! Every key that the runtime reads, as data: what the readers know, the JSON schema and the merged view are
//! made of it.
//!
//! Tests hold this list, what the readers accept, `defaults.toml` and `docs/configuration.md` against each other,
//! so a key is added in all of them or nowhere.

/// A table of keys.
pub(super) struct Table {
    /// Its path, with `NAME` for a name of one's own; empty for the top level.
    pub(super) path: &'static str,
    pub(super) keys: &'static [Key],
}

/// One key.
pub(super) struct Key {
    pub(super) name: &'static str,
    pub(super) kind: Kind,
    /// The default as TOML, where there is one that does not depend on anything else.
    pub(super) default: Option<&'static str>,
    /// What it means, for an editor.
    pub(super) doc: &'static str,
}

/// What a key holds.
pub(super) enum Kind {
    /// A string that is not empty.
    Text,
    /// One of these words.
    Choice(&'static [&'static str]),
    /// `true` or `false`.
    Flag,
    /// `true`, `false` or this word.
    FlagOr(&'static str),
    /// A whole number from the first to the second.
    Integer(u64, u64),
    /// A number from the first to the second.
    Number(f64, f64),
    /// A time in s, above 0 and at most this.
    Seconds(f64),
    /// A list of strings.
    Texts,
    /// A table of this path.
    One(&'static str),
    /// Named tables of this path.
    Named(&'static str),
    /// Named tables that each hold what the top level of a file holds.
    Profiles,
    /// A table that belongs to somebody else.
    Free,
}

const fn key(
    name: &'static str,
    kind: Kind,
    default: Option<&'static str>,
    doc: &'static str,
) -> Key {
    Key {
        name,
        kind,
        default,
        doc,
    }
}

/// The paths of the tables.
pub(super) const TOP: &str = "";
pub(super) const APP: &str = "app";
pub(super) const TIME: &str = "time";
pub(super) const RECORD: &str = "record";
pub(super) const METRICS: &str = "metrics";
pub(super) const CHASSIS: &str = "chassis.NAME";
pub(super) const PROCESSOR: &str = "chassis.NAME.processors.NAME";
pub(super) const TASK: &str = "task.NAME";
pub(super) const SEMAPHORE: &str = "semaphore.NAME";
pub(super) const BARRIER: &str = "barrier.NAME";
pub(super) const INJURE: &str = "injure";
pub(super) const SECURITY: &str = "security";
pub(super) const HOST: &str = "host.NAME";
pub(super) const CONTROL: &str = "control";
pub(super) const ZENOH: &str = "zenoh";

const SCOPE_DOC: &str = "Shared by the tasks of each chassis, or of the whole app. Default: of the app when the name begins with `app/`, else of the chassis.";

/// All tables, outer ones first.
pub(super) const TABLES: &[Table] = &[
    Table {
        path: TOP,
        keys: &[
            key(
                "include",
                Kind::Texts,
                Some("[]"),
                "Files that this one builds on, relative to it. They are read first.",
            ),
            key("app", Kind::One(APP), None, "The app as a whole."),
            key("time", Kind::One(TIME), None, "Its clock."),
            key(
                "chassis",
                Kind::Named(CHASSIS),
                None,
                "Its processes, by name.",
            ),
            key("task", Kind::Named(TASK), None, "Its tasks, by name."),
            key(
                "semaphore",
                Kind::Named(SEMAPHORE),
                None,
                "Counting semaphores that tasks take turns with, by name. Default: as the tasks say.",
            ),
            key(
                "barrier",
                Kind::Named(BARRIER),
                None,
                "Barriers where tasks wait for each other, by name. Default: as the tasks say.",
            ),
            key(
                "injure",
                Kind::One(INJURE),
                None,
                "What goes wrong on purpose with the links between chassis.",
            ),
            key(
                "security",
                Kind::One(SECURITY),
                None,
                "Keys for connections beyond this host.",
            ),
            key(
                "zenoh",
                Kind::One(ZENOH),
                None,
                "The network that joins chassis of different hosts without a list of addresses. Needs a program built with it.",
            ),
            key(
                "record",
                Kind::One(RECORD),
                None,
                "What is written down of it.",
            ),
            key("metrics", Kind::One(METRICS), None, "Where it is watched."),
            key(
                "host",
                Kind::Named(HOST),
                None,
                "Other hosts, by name, each with an agent that waits for boots.",
            ),
            key(
                "control",
                Kind::One(CONTROL),
                None,
                "Where tools of other hosts reach it.",
            ),
            key(
                "profile",
                Kind::Profiles,
                None,
                "Tables that lie over the app's own when the profile is chosen.",
            ),
        ],
    },
    Table {
        path: APP,
        keys: &[
            key(
                "name",
                Kind::Text,
                None,
                "What the app is called in logs and displays. Default: the file's name without `.toml`.",
            ),
            key(
                "profile",
                Kind::Text,
                None,
                "The profile to take when the command line chooses none.",
            ),
            key(
                "seed",
                Kind::Integer(0, u64::MAX),
                Some("1"),
                "Seed of all randomness.",
            ),
            key(
                "until",
                Kind::Text,
                None,
                "The app ends when this task finishes. Default: it runs until it is stopped.",
            ),
            key(
                "phase_timeout_s",
                Kind::Seconds(3600.0),
                Some("20.0"),
                "How long each of the startup phases may take, s.",
            ),
            key(
                "stop_timeout_s",
                Kind::Seconds(3600.0),
                Some("5.0"),
                "How long an orderly stop may take, s.",
            ),
            key(
                "peer_timeout_s",
                Kind::Seconds(3600.0),
                Some("2.0"),
                "After how long without a sign of life a chassis is given up, s.",
            ),
            key(
                "same_host",
                Kind::Choice(&["shm", "unix", "tcp", "zenoh"]),
                Some("\"shm\""),
                "How chassis of one host are joined: shared memory, Unix sockets, the loopback, or the network of [zenoh].",
            ),
            key(
                "spin_us",
                Kind::Integer(0, 1_000_000),
                None,
                "How long a reader of shared memory looks for news before it sleeps, us. Default: 5, with one CPU 0.",
            ),
            key(
                "link_room_mib",
                Kind::Integer(1, 65_536),
                Some("64"),
                "How much may be under way to another chassis and not acknowledged, MiB.",
            ),
            key(
                "listen",
                Kind::Text,
                None,
                "Address at which the boot is reached from other hosts, \"IP:PORT\"; port 0 is a free one. Default: nowhere.",
            ),
        ],
    },
    Table {
        path: TIME,
        keys: &[key(
            "mode",
            Kind::Choice(&["real", "virtual"]),
            Some("\"real\""),
            "The machine's clock with a process per chassis, or one process on a virtual clock.",
        )],
    },
    Table {
        path: RECORD,
        keys: &[
            key(
                "file",
                Kind::Text,
                None,
                "Where messages, phases, firings and log lines are written, as MCAP; each process puts its name before the extension. Default: nothing is recorded.",
            ),
            key(
                "max_mb",
                Kind::Integer(1, 1_000_000),
                Some("256"),
                "A file that has grown to this size is closed and the next one begun, MB.",
            ),
            key(
                "keep",
                Kind::Integer(1, 100_000),
                Some("8"),
                "So many files of a process are kept, older ones are removed.",
            ),
            key(
                "flush_s",
                Kind::Seconds(3600.0),
                Some("1.0"),
                "At most this much is lost when a process is killed, s.",
            ),
            key(
                "buffer_mb",
                Kind::Integer(1, 10_000),
                Some("16"),
                "What a processor may have waiting for the disk, MB; what comes then is dropped and counted.",
            ),
        ],
    },
    Table {
        path: METRICS,
        keys: &[key(
            "listen",
            Kind::Text,
            None,
            "Address on the loopback at which the boot serves /metrics for Prometheus. Default: nowhere.",
        )],
    },
    Table {
        path: CHASSIS,
        keys: &[
            key(
                "host",
                Kind::Text,
                None,
                "The host it lives on, a name of [host]. Default: that of the boot.",
            ),
            key(
                "listen",
                Kind::Text,
                None,
                "Address at which the other chassis reach it, \"IP:PORT\". Default: a free port of its host.",
            ),
            key(
                "stop_first",
                Kind::Flag,
                Some("false"),
                "Whether it is stopped before the others, for hardware that must come to rest first.",
            ),
            key(
                "restart",
                Kind::Choice(&["never", "on-failure", "always"]),
                Some("\"never\""),
                "When its process is started again after it ended; \"never\": the app ends with it.",
            ),
            key(
                "max_restarts",
                Kind::Integer(1, 1_000_000),
                None,
                "So many restarts within the window are the last; the next failure ends the app. Default, where there are restarts: 3.",
            ),
            key(
                "restart_window_s",
                Kind::Seconds(86_400.0),
                None,
                "The window in which restarts are counted, s. Default, where there are restarts: 60.",
            ),
            key(
                "restart_backoff_s",
                Kind::Seconds(3600.0),
                None,
                "The pause before a restart, s; doubles with each one within the window. Default, where there are restarts: 0.5.",
            ),
            key(
                "on_task_failure",
                Kind::Choice(&["app", "restart-chassis"]),
                Some("\"app\""),
                "What a task that failed for good leads to.",
            ),
            key(
                "processors",
                Kind::Named(PROCESSOR),
                None,
                "Its threads, by name. Default: one that is called `main`.",
            ),
        ],
    },
    Table {
        path: PROCESSOR,
        keys: &[
            key(
                "realtime",
                Kind::FlagOr("require"),
                Some("false"),
                "Whether it asks for the real-time scheduler (SCHED_FIFO) and locked memory; \"require\" undoes the boot when they are refused.",
            ),
            key(
                "priority",
                Kind::Integer(1, 99),
                None,
                "Real-time priority; only with `realtime = true`. Default: chosen by the runtime.",
            ),
            key(
                "cpu",
                Kind::Integer(0, 1023),
                None,
                "The CPU it is pinned to, counted from 0. Default: none.",
            ),
            key(
                "period_s",
                Kind::Seconds(3600.0),
                None,
                "The base period of its synchronous functions, s. Default: they bring their own.",
            ),
            key(
                "overrun",
                Kind::Choice(&["skip", "run-late-once", "stop"]),
                Some("\"skip\""),
                "Functions whose turn was among ticks that could not begin in time wait for their next turn, run once, late, or the app is stopped in order.",
            ),
            key(
                "spin_us",
                Kind::Integer(0, 10_000),
                None,
                "How long it spins, us: before a tick (default: 0, with `realtime` as long as its wake-ups were late, 80 to 500), and for messages before it sleeps (default: 20 on a CPU of its own, else 0).",
            ),
        ],
    },
    Table {
        path: TASK,
        keys: &[
            key(
                "handler",
                Kind::Text,
                None,
                "The registered name of the event handler. Needed.",
            ),
            key(
                "on",
                Kind::Text,
                None,
                "Where it runs: \"CHASSIS/PROCESSOR\", or \"CHASSIS\" for that chassis's first processor. Needed.",
            ),
            key(
                "queue",
                Kind::Integer(1, 65_536),
                Some("64"),
                "How many messages may wait for it.",
            ),
            key(
                "restart",
                Kind::Choice(&["never", "on-failure", "always"]),
                Some("\"never\""),
                "When it is built anew: after a panic of its handler, a child or a synchronous function; always: also after a shutdown.",
            ),
            key(
                "max_restarts",
                Kind::Integer(1, 1_000_000),
                None,
                "How many restarts there are within the window at most. Default: 3.",
            ),
            key(
                "restart_window_s",
                Kind::Seconds(86_400.0),
                None,
                "The window, s. Default: 60.",
            ),
            key(
                "restart_backoff_s",
                Kind::Seconds(3_600.0),
                None,
                "The wait before a restart, s; it doubles with each one in the window. Default: 0.1.",
            ),
            key(
                "call_deadline_s",
                Kind::Seconds(86_400.0),
                None,
                "Deadline of the calls it makes, s. Default: the runtime's.",
            ),
            key(
                "handler_limit_s",
                Kind::Seconds(86_400.0),
                None,
                "How long its handler may be at one message before a warning names it, s. Default: 1 where it keeps its processor from others, 30 where it waits.",
            ),
            key(
                "args",
                Kind::Free,
                None,
                "What the handler wants to know; each handler has keys of its own.",
            ),
        ],
    },
    Table {
        path: SEMAPHORE,
        keys: &[
            key("scope", Kind::Choice(&["chassis", "app"]), None, SCOPE_DOC),
            key(
                "permits",
                Kind::Integer(1, 1_000_000),
                None,
                "How many tasks may hold it at once. Default: as the tasks say.",
            ),
        ],
    },
    Table {
        path: INJURE,
        keys: &[
            key(
                "drop",
                Kind::Number(0.0, 0.9),
                Some("0.0"),
                "The probability that a packet is lost; it is sent again.",
            ),
            key(
                "delay",
                Kind::Text,
                None,
                "How much later each packet leaves, such as \"5ms\" or \"5ms..20ms\". Default: not at all.",
            ),
            key(
                "cut",
                Kind::Texts,
                Some("[]"),
                "Links that are cut: two chassis (or `boot`), when, and for how long, such as \"a:b@2s+0.5s\".",
            ),
            key(
                "break_bytes",
                Kind::Integer(0, 1 << 40),
                Some("0"),
                "After how many bytes the first stream of each link breaks, on average; 0 = never.",
            ),
        ],
    },
    Table {
        path: BARRIER,
        keys: &[
            key("scope", Kind::Choice(&["chassis", "app"]), None, SCOPE_DOC),
            key(
                "parties",
                Kind::Integer(1, 1_000_000),
                None,
                "How many must arrive before all go on. Default: as the tasks say.",
            ),
        ],
    },
    Table {
        path: SECURITY,
        keys: &[
            key(
                "key",
                Kind::Text,
                None,
                "The key of the app's chassis without its ending, made by `ctos keys new`.",
            ),
            key(
                "authority",
                Kind::Text,
                None,
                "The certificate of the authority that signs all keys.",
            ),
        ],
    },
    Table {
        path: HOST,
        keys: &[key(
            "agent",
            Kind::Text,
            None,
            "Where `ctos agent` listens on that host, \"IP:PORT\". Needed.",
        )],
    },
    Table {
        path: CONTROL,
        keys: &[key(
            "listen",
            Kind::Text,
            None,
            "Address at which tools reach the app with `--at`, \"IP:PORT\". Default: nowhere.",
        )],
    },
    Table {
        path: ZENOH,
        keys: &[
            key(
                "mode",
                Kind::Choice(&["peer", "client", "router"]),
                None,
                "What its processes are in the network: peers, clients of a router, or clients of the boot, which is their router. Default: peer.",
            ),
            key(
                "connect",
                Kind::Texts,
                None,
                "Whom each process connects to, such as \"tls/10.0.0.5:7447\": routers, or peers that know others. Default: nobody.",
            ),
            key(
                "listen",
                Kind::Texts,
                None,
                "Where each process can be connected to, with port 0; with mode = \"router\" where the boot can, with a port. Default: a free port of the loopback.",
            ),
            key(
                "multicast",
                Kind::Text,
                None,
                "The interface on which they find each other by multicast, such as \"lo\". Default: not at all.",
            ),
        ],
    },
];

/// The table of that path.
pub(super) fn table(path: &str) -> &'static [Key] {
    let found = TABLES.iter().find(|table| table.path == path);
    found.map_or(&[], |table| table.keys)
}

/// The names of its keys.
pub(super) fn names(path: &str) -> impl Iterator<Item = &'static str> {
    table(path).iter().map(|key| key.name)
}
