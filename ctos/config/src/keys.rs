//! Every key that the runtime reads, as data: what may stand where, the defaults and the JSON schema are made of it.
//!
//! Tests hold this list, what the readers accept, `defaults.toml` and `docs/configuration.md` against each other,
//! so a key is added in all of them or nowhere.

/// A table of keys.
pub(super) struct Table {
    /// Its path, with `NAME` for a name of one's own; empty for the top level.
    pub(super) path: &'static str,
    pub(super) keys: &'static [Key],
}

pub(super) struct Key {
    pub(super) name: &'static str,
    pub(super) kind: Kind,
    /// The default as TOML, where there is one that does not depend on anything else.
    pub(super) default: Option<&'static str>,
    /// What to do when it is missing from a table that needs it.
    pub(super) needed: Option<&'static str>,
    /// What it means, for an editor.
    pub(super) doc: &'static str,
}

/// What a key holds.
pub(super) enum Kind {
    /// A string that is not empty.
    Text,
    /// An IP address with a port; this is one.
    Address(&'static str),
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
    /// A list of strings; this is one.
    Texts(&'static str),
    /// A table of this path.
    One(&'static str),
    /// Named tables of this path.
    Named(&'static str),
    /// Named tables that each hold what the top level of a file holds.
    Profiles,
    /// A table that belongs to somebody else.
    Free,
}

/// A table of the list: its path, then its keys.
macro_rules! table {
    ($path:expr; $($name:literal: $kind:ident $(($($of:tt)*))? $(= $default:literal)? $(needed $needed:literal)?, $doc:expr;)+) => {
        Table {
            path: $path,
            keys: &[$(Key {
                name: $name,
                kind: Kind::$kind $(($($of)*))?,
                default: table!(@option $($default)?),
                needed: table!(@option $($needed)?),
                doc: $doc,
            }),+],
        }
    };
    (@option) => { None };
    (@option $there:literal) => { Some($there) };
}

/// The top level of a file.
pub(super) const TOP: &str = "";
/// A processor of a chassis.
pub(super) const PROCESSOR: &str = "chassis.NAME.processors.NAME";

const SCOPE_DOC: &str = "Shared by the tasks of each chassis, or of the whole app. Default: of the app when the name begins with `app/`, else of the chassis.";

/// All tables, outer ones first. Each line: a key, what it holds, its default where there is one, what it means.
#[rustfmt::skip]
pub(super) const TABLES: &[Table] = &[
    table! { TOP;
        "include": Texts("[\"common.toml\"]") = "[]", "Files that this one builds on, relative to it. They are read first.";
        "app": One("app"), "The app as a whole.";
        "time": One("time"), "Its clock.";
        "chassis": Named("chassis.NAME"), "Its processes, by name.";
        "task": Named("task.NAME"), "Its tasks, by name.";
        "semaphore": Named("semaphore.NAME"), "Counting semaphores that tasks take turns with, by name. Default: as the tasks say.";
        "barrier": Named("barrier.NAME"), "Barriers where tasks wait for each other, by name. Default: as the tasks say.";
        "injure": One("injure"), "What goes wrong on purpose with the links between chassis.";
        "security": One("security"), "Keys for connections beyond this host.";
        "zenoh": One("zenoh"), "The network that joins chassis of different hosts without a list of addresses. Needs a program built with it.";
        "record": One("record"), "What is written down of it.";
        "metrics": One("metrics"), "Where it is watched.";
        "host": Named("host.NAME"), "Other hosts, by name, each with an agent that waits for boots.";
        "control": One("control"), "Where tools of other hosts reach it.";
        "profile": Profiles, "Tables that lie over the app's own when the profile is chosen.";
    },
    table! { "app";
        "name": Text, "What the app is called in logs and displays. Default: the file's name without `.toml`.";
        "profile": Text, "The profile to take when the command line chooses none.";
        "seed": Integer(0, u64::MAX) = "1", "Seed of all randomness.";
        "until": Text, "The app ends when this task finishes. Default: it runs until it is stopped.";
        "phase_timeout_s": Seconds(3600.0) = "20.0", "How long each of the startup phases may take, s.";
        "stop_timeout_s": Seconds(3600.0) = "5.0", "How long an orderly stop may take, s.";
        "peer_timeout_s": Seconds(3600.0) = "2.0", "After how long without a sign of life a chassis is given up, s.";
        "same_host": Choice(&["shm", "unix", "tcp", "zenoh"]) = "\"shm\"", "How chassis of one host are joined: shared memory, Unix sockets, the loopback, or the network of [zenoh].";
        "spin_us": Integer(0, 1_000_000), "How long a reader of shared memory looks for news before it sleeps, us. Default: 5, with one CPU 0.";
        "link_unacknowledged_mib": Integer(1, 65_536) = "64", "How much may be under way to another chassis and not acknowledged, MiB.";
        "listen": Address("192.168.1.10:0"), "Address at which the boot is reached from other hosts, \"IP:PORT\"; port 0 is a free one. Default: nowhere.";
    },
    table! { "time";
        "mode": Choice(&["real", "virtual"]) = "\"real\"", "The machine's clock with a process per chassis, or one process on a virtual clock.";
    },
    table! { "record";
        "file": Text, "Where messages, phases, firings and log lines are written, as MCAP; each process puts its name before the extension. Default: nothing is recorded.";
        "max_mb": Integer(1, 1_000_000) = "256", "A file that has grown to this size is closed and the next one begun, MB.";
        "keep": Integer(1, 100_000) = "8", "So many files of a process are kept, older ones are removed.";
        "flush_s": Seconds(3600.0) = "1.0", "At most this much is lost when a process is killed, s.";
        "buffer_mb": Integer(1, 10_000) = "16", "What a processor may have waiting for the disk, MB; what comes then is dropped and counted.";
        "channels": Texts("[\"/tf/*\"]") = "[]", "The channels that are written, in whose names `*` stands for any characters; none: all.";
    },
    table! { "metrics";
        "listen": Address("127.0.0.1:9464"), "Address on the loopback at which the boot serves /metrics for Prometheus. Default: nowhere.";
    },
    table! { "chassis.NAME";
        "host": Text, "The host it lives on, a name of [host]. Default: that of the boot.";
        "listen": Address("127.0.0.1:0"), "Address at which the other chassis reach it, \"IP:PORT\". Default: a free port of its host.";
        "stop_first": Flag = "false", "Whether it is stopped before the others, for hardware that must come to rest first.";
        "start": Choice(&["boot", "on-demand"]) = "\"boot\"", "When its process starts: with the app, or when somebody looks for one of its tasks.";
        "restart": Choice(&["never", "on-failure", "always"]) = "\"never\"", "When its process is started again after it ended; \"never\": the app ends with it.";
        "max_restarts": Integer(1, 1_000_000), "So many restarts within the window are the last; the next failure ends the app. Default, where there are restarts: 3.";
        "restart_window_s": Seconds(86_400.0), "The window in which restarts are counted, s. Default, where there are restarts: 60.";
        "restart_backoff_s": Seconds(3600.0), "The pause before a restart, s; doubles with each one within the window, up to 30 s. Default, where there are restarts: 0.5.";
        "on_task_failure": Choice(&["app", "restart-chassis"]) = "\"app\"", "What a task that failed for good leads to.";
        "processors": Named(PROCESSOR), "Its threads, by name. Default: one that is called `main`.";
    },
    table! { PROCESSOR;
        "realtime": FlagOr("require") = "false", "Whether it asks for the real-time scheduler (SCHED_FIFO) and locked memory; \"require\" undoes the boot when they are refused.";
        "priority": Integer(1, 99), "Real-time priority; only with `realtime = true`. Default: chosen by the runtime.";
        "cpu": Integer(0, 1023), "The CPU it is pinned to, counted from 0. Default: none.";
        "period_s": Seconds(3600.0), "The base period of its synchronous functions, s. Default: they bring their own.";
        "overrun": Choice(&["skip", "run-late-once", "stop"]) = "\"skip\"", "Functions whose turn was among ticks that could not begin in time wait for their next turn, run once, late, or the app is stopped in order.";
        "spin_us": Integer(0, 10_000), "How long it spins, us: before a tick (default: 0, with `realtime` as long as its wake-ups were late, 80 to 500), and for messages before it sleeps (default: 20 on a CPU of its own, else 0).";
    },
    table! { "task.NAME";
        "handler": Text needed "add handler = \"NAME\", the handler that this task runs", "The registered name of the event handler. Needed.";
        "on": Text needed "add on = \"CHASSIS\" or on = \"CHASSIS/PROCESSOR\"", "Where it runs: \"CHASSIS/PROCESSOR\", or \"CHASSIS\" for that chassis's first processor. Needed.";
        "queue": Integer(1, 65_536) = "64", "How many messages may wait for it.";
        "restart": Choice(&["never", "on-failure", "always"]) = "\"never\"", "When it is built anew: after a panic of its handler, a child or a synchronous function; always: also after a shutdown.";
        "state": Choice(&["memory", "durable"]) = "\"memory\"", "Whether its state survives its process: stored before an answer leaves, and taken over by the next process.";
        "max_restarts": Integer(1, 1_000_000), "How many restarts there are within the window at most. Default: 3.";
        "restart_window_s": Seconds(86_400.0), "The window, s. Default: 60.";
        "restart_backoff_s": Seconds(3_600.0), "The wait before a restart, s; it doubles with each one in the window, up to 30 s. Default: 0.1.";
        "call_deadline_s": Seconds(86_400.0), "Deadline of the calls it makes, s. Default: the runtime's.";
        "handler_limit_s": Seconds(86_400.0), "How long its handler may be at one message before a warning names it, s. Default: 1 where it keeps its processor from others, 30 where it waits.";
        "args": Free, "What the handler wants to know; each handler has keys of its own.";
    },
    table! { "semaphore.NAME";
        "scope": Choice(&["chassis", "app"]), SCOPE_DOC;
        "permits": Integer(1, 1_000_000), "How many tasks may hold it at once. Default: as the tasks say.";
    },
    table! { "injure";
        "drop": Number(0.0, 0.9) = "0.0", "The probability that a packet is lost; it is sent again.";
        "delay": Text, "How much later each packet leaves, such as \"5ms\" or \"5ms..20ms\". Default: not at all.";
        "cut": Texts("[\"a:b@2s\"]") = "[]", "Links that are cut: two chassis (or `boot`), when, and for how long, such as \"a:b@2s+0.5s\".";
        "break_bytes": Integer(0, 1 << 40) = "0", "After how many bytes the first stream of each link breaks, on average; 0 = never.";
    },
    table! { "barrier.NAME";
        "scope": Choice(&["chassis", "app"]), SCOPE_DOC;
        "parties": Integer(1, 1_000_000), "How many must arrive before all go on. Default: as the tasks say.";
    },
    table! { "security";
        "key": Text needed "make keys with `ctos keys new keys/NAME --role boot`, then add key = \"keys/NAME\"", "The key of the app's chassis without its ending, made by `ctos keys new`.";
        "authority": Text needed "make keys with `ctos keys new keys/NAME --role boot`, then add authority = \"keys/ca.pem\"", "The certificate of the authority that signs all keys.";
    },
    table! { "host.NAME";
        "agent": Address("192.168.1.20:7410") needed "add agent = \"IP:PORT\", where `ctos agent` listens on that host", "Where `ctos agent` listens on that host, \"IP:PORT\". Needed.";
    },
    table! { "control";
        "listen": Address("192.168.1.10:7411"), "Address at which tools reach the app with `--at`, \"IP:PORT\". Default: nowhere.";
    },
    table! { "zenoh";
        "mode": Choice(&["peer", "client", "router"]), "What its processes are in the network: peers, clients of a router, or clients of the boot, which is their router. Default: peer.";
        "connect": Texts("[\"tls/10.0.0.5:7447\"]"), "Whom each process connects to, such as \"tls/10.0.0.5:7447\": routers, or peers that know others. Default: nobody.";
        "listen": Texts("[\"tcp/127.0.0.1:7447\"]"), "Where each process can be connected to, with port 0; with mode = \"router\" where the boot can, with a port. Default: a free port of the loopback.";
        "multicast": Text, "The interface on which they find each other by multicast, such as \"lo\". Default: not at all.";
    },
];

pub(super) fn table(path: &str) -> &'static [Key] {
    let found = TABLES.iter().find(|table| table.path == path);
    found.map_or(&[], |table| table.keys)
}

/// The names of its keys.
pub(super) fn names(path: &str) -> impl Iterator<Item = &str> {
    table(path).iter().map(|key| key.name)
}
