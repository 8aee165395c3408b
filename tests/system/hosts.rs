//! Apps whose chassis live on other hosts: agents, each in a folder of its own with processes of its
//! own, stand for the hosts.

use std::{
    fs,
    io::{Read, Write},
    net::TcpStream,
    os::unix::fs::{DirBuilderExt, PermissionsExt, symlink},
    path::PathBuf,
    sync::Mutex,
};

use rustix::process::Signal;
use serde_json::Value;

use crate::harness::{CTOS, Ended, MISBEHAVING, Run, Scratch};

/// Where the secrets of the agents' ports are: each of these hosts is a folder, and all are of one user.
static TOKENS: Mutex<Vec<(String, PathBuf)>> = Mutex::new(Vec::new());

/// An agent of the program whose handlers misbehave, and where it listens.
pub struct Agent<'a> {
    pub run: Run<'a>,
    pub address: String,
}

impl<'a> Agent<'a> {
    pub fn start(host: &'a Scratch, arguments: &[&str]) -> Self {
        Self::start_of(MISBEHAVING, host, arguments)
    }

    fn start_of(program: &str, host: &'a Scratch, arguments: &[&str]) -> Self {
        let listen = ["agent", "--dir", "."];
        let port = ["--listen", "127.0.0.1:0"];
        let port = if arguments.contains(&"--listen") {
            &[][..]
        } else {
            &port
        };
        let all = [&listen[..], port, arguments].concat();
        let mut run = host.start(program, &all, &[]);
        let line = run.line_with("listen");
        // `agent    listens at ADDRESS`, or `{"event":"listening","address":"ADDRESS"}`.
        let mut words = line.trim().split([' ', '"']);
        let address = words.rfind(|word| word.ends_with(|letter: char| letter.is_ascii_digit()));
        let address = address.unwrap().to_owned();
        let token = host.path(&format!("ctos/{address}.token"));
        TOKENS.lock().unwrap().push((address.clone(), token));
        Self { run, address }
    }

    /// Tells the agent to end, and makes sure that nothing of it is left.
    #[track_caller]
    pub fn end(self) -> Ended {
        self.run.signal(Signal::TERM);
        let ended = self.run.end();
        ended.must_exit(0);
        ended
    }
}

fn run_folders(host: &Scratch) -> Vec<PathBuf> {
    let folder = fs::read_dir(host.path(".")).unwrap();
    let paths = folder.map(|entry| entry.unwrap().path());
    paths
        .filter(|path| {
            let name = path.file_name().unwrap().to_string_lossy();
            path.is_dir() && name.starts_with("ctos-run-")
        })
        .collect()
}

/// An app with a chassis here and one on each of two hosts.
fn app(x: &str, y: &str, more: &str) -> String {
    format!(
        r#"
[app]
name = "cell"
stop_timeout_s = 2
same_host = "tcp"

[host.x]
agent = "{x}"
[host.y]
agent = "{y}"

[chassis.desk]
[chassis.cage]
host = "x"
{more}
[chassis.eye]
host = "y"

[task.arm]
handler = "test.steady"
on = "cage"
args = {{ slow_s = 0.0 }}

[task.cam]
handler = "test.steady"
on = "eye"
args = {{ slow_s = 0.0 }}

[task.hand]
handler = "test.steady"
on = "desk"
args = {{ slow_s = 0.0, waits_for = "arm" }}
"#
    )
}

/// An app with one chassis here and one on a host.
pub fn pair(agent: &str, more: &str) -> String {
    format!(
        r#"
[app]
name = "pair"
stop_timeout_s = 2
peer_timeout_s = 1

[host.x]
agent = "{agent}"

[chassis.desk]
[chassis.cage]
host = "x"
{more}

[task.arm]
handler = "test.steady"
on = "cage"
args = {{ slow_s = 0.0 }}

[task.hand]
handler = "test.steady"
on = "desk"
args = {{ slow_s = 0.0 }}
"#
    )
}

pub fn boot<'a>(scratch: &'a Scratch, text: &str, arguments: &[&str]) -> Run<'a> {
    scratch.write("app.toml", text);
    for (address, token) in TOKENS.lock().unwrap().iter() {
        if text.contains(address) {
            let folder = scratch.path("ctos");
            // It may have booted before.
            let _ = fs::DirBuilder::new().mode(0o700).create(&folder);
            let _ = symlink(token, folder.join(token.file_name().unwrap()));
        }
    }
    let all = [&["boot", "app.toml"], arguments].concat();
    scratch.start(MISBEHAVING, &all, &[])
}

pub fn ask(scratch: &Scratch, arguments: &[&str]) -> Ended {
    scratch.start(MISBEHAVING, arguments, &[]).end()
}

pub fn free_port() -> u16 {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    listener.local_addr().unwrap().port()
}

#[test]
fn an_app_of_three_hosts_boots_shows_its_logs_and_leaves_nothing() {
    let [here, x, y] = [Scratch::empty(), Scratch::empty(), Scratch::empty()];
    let (mut on_x, mut on_y) = (Agent::start(&x, &[]), Agent::start(&y, &["--json"]));
    assert!(on_y.address.contains("127.0.0.1:"), "{}", on_y.address);
    let mut run = boot(&here, &app(&on_x.address, &on_y.address, ""), &[]);
    run.wait_for("phase 3");

    let view = ask(&here, &["ps", "--json"]);
    let view = view.must_exit_leaving(0).json();
    for (chassis, host) in [
        ("desk", Value::Null),
        ("cage", "x".into()),
        ("eye", "y".into()),
    ] {
        let mut all = view["chassis"].as_array().unwrap().iter();
        let shown = all.find(|one| one["name"] == chassis).unwrap();
        assert_eq!(
            (&shown["host"], &shown["state"]),
            (&host, &"up".into()),
            "{view}"
        );
        let pid = run.chassis[chassis].pid.as_raw_nonzero().get();
        assert_eq!(shown["pid"], pid, "{view}");
    }
    let logs = ask(&here, &["logs", "arm", "--json"]);
    let lines = logs.must_exit_leaving(0).json_lines();
    assert_eq!(lines.len(), 3, "one for each phase: {}", logs.told);
    let shown = ask(&here, &["ps"]);
    assert!(shown.stdout.contains("cage on x") && shown.stdout.contains("desk on here"));
    for host in [&x, &y] {
        let folders = run_folders(host);
        assert_eq!(folders.len(), 1);
        let mode = folders[0].metadata().unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o700);
    }

    run.signal(Signal::INT);
    let ended = run.end();
    ended
        .must_exit(130)
        .must_say("on x")
        .must_say("cage │")
        .must_say("eye  │")
        .must_say("is in phase run task=arm")
        .must_say("stops because the app was interrupted task=cam")
        .must_not_say("does not end");
    on_x.run
        .wait_for("ended    cell/cage ended with exit code 1");
    on_x.run.wait_for("over     cell: the boot has ended it");
    on_y.run.wait_for(r#""event":"over","app":"cell""#);
    for (host, agent) in [(&x, on_x), (&y, on_y)] {
        assert!(run_folders(host).is_empty());
        assert_eq!(host.processes().len(), 1, "the agent alone");
        agent.end();
    }
}

#[test]
fn a_boot_that_fails_on_one_host_is_undone_on_all() {
    let [here, x, y] = [Scratch::empty(), Scratch::empty(), Scratch::empty()];
    let (mut on_x, mut on_y) = (Agent::start(&x, &[]), Agent::start(&y, &[]));
    let text = app(&on_x.address, &on_y.address, "");
    let cam = "[task.cam]\nhandler = \"test.steady\"\non = \"eye\"\nargs = { slow_s = 0.0 }";
    let refuses = "[task.cam]\nhandler = \"test.misbehaving\"\non = \"eye\"\nargs = { fault = \"refuse\", phase = \"connect\" }";
    let text = text.replace(cam, refuses);
    assert!(text.contains("refuse"));
    let ended = boot(&here, &text, &[]).end();
    ended
        .must_exit(1)
        .must_say("startup phase `connect` failed and the boot was undone")
        .must_say("task `cam`: the hardware does not answer");
    for agent in [&mut on_x, &mut on_y] {
        agent.run.wait_for("over     cell: the boot has ended it");
    }
    for (host, agent) in [(&x, on_x), (&y, on_y)] {
        assert!(run_folders(host).is_empty());
        agent.end();
    }
}

#[test]
fn hosts_that_cannot_be_reached_are_named_with_what_to_do_and_nothing_is_started() {
    let here = Scratch::empty();
    let (x, y) = (free_port(), free_port());
    let text = app(&format!("127.0.0.1:{x}"), &format!("127.0.0.1:{y}"), "");
    let ended = boot(&here, &text, &[]).end();
    ended
        .must_exit(5)
        .must_say(&format!(
            "host `x` (127.0.0.1:{x}): its agent cannot be reached"
        ))
        .must_say(&format!(
            "host `y` (127.0.0.1:{y}): its agent cannot be reached"
        ))
        .must_say(&format!(
            "start it there: ctos agent --listen 127.0.0.1:{y}"
        ))
        .must_not_say("pid");
}

#[test]
fn one_host_that_cannot_be_reached_undoes_the_others() {
    let [here, x] = [Scratch::empty(), Scratch::empty()];
    let mut on_x = Agent::start(&x, &[]);
    let gone = format!("127.0.0.1:{}", free_port());
    let ended = boot(&here, &app(&on_x.address, &gone, ""), &[]).end();
    ended
        .must_exit(5)
        .must_say("host `y`")
        .must_not_say("host `x`");
    on_x.run.wait_for("over     cell: the boot has ended it");
    assert!(run_folders(&x).is_empty());
    on_x.end();
}

#[test]
fn a_chassis_on_another_host_that_is_killed_comes_back() {
    let [here, x] = [Scratch::empty(), Scratch::empty()];
    let mut on_x = Agent::start(&x, &[]);
    let policy = "restart = \"on-failure\"\nrestart_backoff_s = 0.1";
    let mut run = boot(&here, &pair(&on_x.address, policy), &[]);
    run.wait_for("phase 3");
    run.kill("cage");
    run.wait_for("failed   cage was killed by signal 9 (SIGKILL)");
    run.wait_for("restart  cage as process 2");
    run.wait_for("restart  cage is up again");
    run.signal(Signal::INT);
    run.end().must_exit(130);
    on_x.run.wait_for("over     pair: the boot has ended it");
    on_x.end();
}

#[test]
fn a_chassis_on_another_host_starts_on_demand() {
    let [here, x] = [Scratch::empty(), Scratch::empty()];
    let agent = Agent::start(&x, &[]);
    let text = pair(&agent.address, "start = \"on-demand\"");
    let mut run = boot(&here, &text, &[]);
    run.wait_for("phase 3");
    assert_eq!(x.processes().len(), 1, "the agent alone");
    ask(&here, &["restart", "cage"]).must_exit_leaving(0);
    run.wait_for("start    cage is up");
    assert_eq!(x.processes().len(), 2, "the agent and the chassis");
    run.signal(Signal::INT);
    run.end()
        .must_exit(130)
        .must_say("start    cage, on demand: ")
        .must_not_say("restart");
    assert_eq!(x.processes().len(), 1, "the agent alone");
    agent.end();
}

#[test]
fn when_an_agent_is_killed_the_app_ends_and_nothing_is_left_on_its_host() {
    let [here, x] = [Scratch::empty(), Scratch::empty()];
    let on_x = Agent::start(&x, &[]);
    let mut run = boot(&here, &pair(&on_x.address, ""), &[]);
    run.wait_for("phase 3");
    on_x.run.signal(Signal::KILL);
    let killed = on_x.run.end();
    assert_eq!(killed.signal, Some(9));
    let ended = run.end();
    ended.must_exit(1);
    assert!(
        ended.chassis["cage"].ends(),
        "it has lost its hold: {}",
        ended.told
    );
    assert!(x.processes().is_empty());
}

#[test]
fn a_chassis_whose_agent_was_killed_comes_back_with_the_next_agent() {
    let [here, x] = [Scratch::empty(), Scratch::empty()];
    let on_x = Agent::start(&x, &[]);
    let policy = "restart = \"on-failure\"\nmax_restarts = 1000\nrestart_backoff_s = 0.1";
    let mut run = boot(&here, &pair(&on_x.address, policy), &[]);
    run.wait_for("phase 3");
    let address = on_x.address.clone();
    on_x.run.signal(Signal::KILL);
    on_x.run.end();
    run.wait_for("failed   cage");
    let mut anew = Agent::start(&x, &["--listen", &address]);
    run.wait_for("restart  cage is up again");
    run.signal(Signal::INT);
    run.end().must_exit(130);
    anew.run.wait_for("over     pair: the boot has ended it");
    anew.end();
}

#[test]
fn an_agent_that_never_comes_back_uses_up_the_restarts() {
    let [here, x] = [Scratch::empty(), Scratch::empty()];
    let on_x = Agent::start(&x, &[]);
    let policy = "restart = \"on-failure\"\nmax_restarts = 2\nrestart_backoff_s = 0.1";
    let mut run = boot(&here, &pair(&on_x.address, policy), &[]);
    run.wait_for("phase 3");
    on_x.run.signal(Signal::KILL);
    on_x.run.end();
    let ended = run.end();
    ended
        .must_exit(1)
        .must_say("was restarted 2 times within")
        .must_say("could not be started: host `x`");
    assert!(ended.chassis["cage"].ends());
}

#[test]
fn when_a_boot_is_killed_the_agent_ends_what_it_has_started() {
    let [here, x] = [Scratch::empty(), Scratch::empty()];
    let mut on_x = Agent::start(&x, &[]);
    // A task that never gives its processor back does not stop by itself.
    let text = pair(&on_x.address, "").replace(
        "[task.arm]\nhandler = \"test.steady\"\non = \"cage\"\nargs = { slow_s = 0.0 }",
        "[task.arm]\nhandler = \"test.misbehaving\"\non = \"cage\"\nargs = { fault = \"block\", phase = \"stop\" }",
    );
    assert!(text.contains("block"));
    let mut run = boot(&here, &text, &[]);
    run.wait_for("phase 3");
    run.signal(Signal::KILL);
    on_x.run.wait_for("ended    pair/cage");
    on_x.run.wait_for("over     pair: its boot is gone");
    let ended = run.end();
    assert_eq!(ended.signal, Some(9));
    assert!(ended.chassis["cage"].ends() && ended.chassis["desk"].ends());
    assert!(run_folders(&x).is_empty());
    assert_eq!(x.processes().len(), 1, "the agent alone");
    on_x.end();
}

#[test]
fn an_agent_that_is_frozen_is_noticed_and_cleans_up_when_it_goes_on() {
    let [here, x] = [Scratch::empty(), Scratch::empty()];
    let mut on_x = Agent::start(&x, &[]);
    let mut run = boot(&here, &pair(&on_x.address, ""), &[]);
    run.wait_for("phase 3");
    on_x.run.signal(Signal::STOP);
    run.wait_for("failed   cage is lost with its host `x`");
    let ended = run.end();
    ended
        .must_exit(1)
        .must_say("nothing was heard of it for 1.000 s");
    on_x.run.signal(Signal::CONT);
    on_x.run.wait_for("over     pair: its boot is gone");
    assert!(ended.chassis["cage"].ends());
    assert!(run_folders(&x).is_empty());
    on_x.end();
}

#[test]
fn an_agent_that_is_stopped_ends_what_it_has_started() {
    let [here, x] = [Scratch::empty(), Scratch::empty()];
    let on_x = Agent::start(&x, &[]);
    let mut run = boot(&here, &pair(&on_x.address, ""), &[]);
    run.wait_for("phase 3");
    let ended = on_x.end();
    ended.must_say("over     pair: the agent is being stopped");
    run.end().must_exit(1);
}

#[test]
fn two_apps_on_one_agent_are_separate() {
    let [one, other, x] = [Scratch::empty(), Scratch::empty(), Scratch::empty()];
    let mut on_x = Agent::start(&x, &[]);
    let mut first = boot(&one, &pair(&on_x.address, ""), &[]);
    let mut second = boot(
        &other,
        &pair(&on_x.address, "").replace("\"pair\"", "\"twin\""),
        &[],
    );
    first.wait_for("phase 3");
    second.wait_for("phase 3");
    assert_eq!(run_folders(&x).len(), 2);
    first.signal(Signal::KILL);
    on_x.run.wait_for("over     pair");
    assert_eq!(run_folders(&x).len(), 1);
    let view = ask(&other, &["ps", "--json"]);
    assert_eq!(
        view.must_exit_leaving(0).json()["chassis"][1]["answers"],
        true
    );
    second.signal(Signal::INT);
    second.end().must_exit(130);
    on_x.run.wait_for("over     twin: the boot has ended it");
    first.end();
    on_x.end();
}

#[test]
fn an_agent_of_another_program_says_which_handler_it_lacks() {
    let [here, x] = [Scratch::empty(), Scratch::empty()];
    let mut on_x = Agent::start_of(CTOS, &x, &[]);
    let ended = boot(&here, &pair(&on_x.address, ""), &[]).end();
    ended
        .must_exit(5)
        .must_say("host `x`")
        .must_say("has no event handler `test.steady`");
    on_x.run.wait_for("refused  app `pair`");
    on_x.end();
}

#[test]
fn rubbish_is_refused_and_the_next_boot_is_served() {
    let [here, x] = [Scratch::empty(), Scratch::empty()];
    let mut on_x = Agent::start(&x, &[]);
    for rubbish in [
        &b"GET / HTTP/1.1\r\n\r\n"[..],
        &[0xff; 4096],
        b"ctosagt\0\xff\xff\xff\x7f",
    ] {
        let mut stream = TcpStream::connect(&on_x.address).unwrap();
        stream.write_all(rubbish).unwrap();
        on_x.run.wait_for("refused  127.0.0.1:");
        // It is hung up, one way or the other.
        let _ = stream.read_to_end(&mut Vec::new());
    }
    let mut run = boot(&here, &pair(&on_x.address, ""), &[]);
    run.wait_for("phase 3");
    run.signal(Signal::INT);
    run.end().must_exit(130);
    on_x.end();
}

#[test]
fn a_record_of_a_chassis_stays_on_its_host() {
    let [here, x] = [Scratch::empty(), Scratch::empty()];
    let mut on_x = Agent::start(&x, &[]);
    let mut run = boot(&here, &pair(&on_x.address, ""), &["--record", "run.mcap"]);
    run.wait_for("phase 3");
    run.signal(Signal::INT);
    run.end().must_exit(130);
    on_x.run.wait_for("over     pair");
    let names = |host: &Scratch| -> Vec<String> {
        let folder = fs::read_dir(host.path(".")).unwrap();
        let names = folder.map(|entry| entry.unwrap().file_name().into_string().unwrap());
        names.filter(|name| name.ends_with(".mcap")).collect()
    };
    let there = names(&x);
    assert!(
        there.len() == 1 && there[0].ends_with(".cage.mcap"),
        "{there:?}"
    );
    let mut known = names(&here);
    known.sort_unstable();
    assert_eq!(known, ["run.boot.mcap", "run.desk.mcap"]);
    on_x.end();
}

#[test]
fn an_agent_beyond_the_loopback_needs_a_key_and_says_so() {
    let x = Scratch::empty();
    let ended = ask(&x, &["agent", "--listen", "0.0.0.0:0"]);
    ended
        .must_exit(2)
        .must_say("needs a key")
        .must_say("ctos keys new");
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let taken = port.local_addr().unwrap().to_string();
    let ended = ask(&x, &["agent", "--listen", &taken]);
    ended
        .must_exit(1)
        .must_say(&format!("cannot listen at {taken}"));
    let ended = ask(
        &x,
        &["agent", "--listen", "127.0.0.1:0", "--dir", "nowhere"],
    );
    ended.must_exit(1).must_say("nowhere");
}

/// A network of its own with two addresses that are not the loopback's.
struct Network {
    holder: std::process::Child,
}

impl Network {
    /// `None` where the system does not permit it.
    fn new() -> Option<Self> {
        use std::io::{BufRead, BufReader};
        use std::process::{Command, Stdio};
        let script = "ip link set lo up && ip addr add 10.77.0.1/32 dev lo && ip addr add 10.77.0.2/32 dev lo && echo ready && cat";
        let mut holder = Command::new("unshare")
            .args(["--net", "sh", "-c", script])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .ok()?;
        let mut line = String::new();
        let said = BufReader::new(holder.stdout.take()?).read_line(&mut line);
        if said.is_ok() && line == "ready\n" {
            return Some(Self { holder });
        }
        holder.wait().unwrap();
        None
    }

    /// How a program is started in it.
    fn within(&self, arguments: &[&str]) -> Vec<String> {
        let pid = self.holder.id().to_string();
        let enter = ["-t", &pid, "-n"].map(str::to_owned);
        let rest = arguments.iter().map(|argument| (*argument).to_owned());
        enter.into_iter().chain(rest).collect()
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        // It ends with its standard input; the test has passed or failed by now.
        drop(self.holder.stdin.take());
        let _ = self.holder.wait();
    }
}

/// The same over addresses that others could reach, with processes that cannot see each other. Over TLS,
/// with clocks that are compared; each process listens at its own host's address.
#[test]
fn hosts_that_see_nothing_of_each_other_but_their_addresses_make_one_app() {
    let Some(network) = Network::new() else {
        return;
    };
    let [here, x] = [Scratch::empty(), Scratch::empty()];
    for key in ["keys/cell", "keys/cage"] {
        ask(&here, &["keys", "new", key, "--role", "boot"]).must_exit(0);
    }
    let key = here.path("keys/cage");
    let key = key.to_str().unwrap();
    let isolated = [
        "unshare",
        "--pid",
        "--fork",
        "--kill-child",
        "--mount-proc",
        "--mount",
    ];
    let agent = [
        MISBEHAVING,
        "agent",
        "--listen",
        "10.77.0.2:7410",
        "--dir",
        ".",
        "--key",
        key,
    ];
    let agent = network.within(&[&isolated[..], &agent].concat());
    let agent: Vec<&str> = agent.iter().map(String::as_str).collect();
    let mut on_x = x.start("nsenter", &agent, &[]);
    on_x.wait_for("agent    listens at 10.77.0.2:7410");

    let security = "[security]\nkey = \"keys/cell\"\nauthority = \"keys/ca.pem\"\n";
    let text = pair("10.77.0.2:7410", "").replace(
        "name = \"pair\"",
        "name = \"pair\"\nlisten = \"10.77.0.1:0\"",
    );
    here.write("app.toml", format!("{text}{security}"));
    let command = network.within(&[MISBEHAVING, "boot", "app.toml"]);
    let command: Vec<&str> = command.iter().map(String::as_str).collect();
    let mut run = here.start("nsenter", &command, &[]);
    run.wait_for("phase 3");
    let view = ask(&here, &["ps", "--json"]);
    let view = view.must_exit_leaving(0).json();
    assert_eq!(view["chassis"][1]["answers"], true, "{view}");
    assert_eq!(view["refused"], 0, "{view}");
    // The line of the other host's log bears the app's time, not that of a clock of its own.
    let logs = ask(&here, &["logs", "arm", "--json"]);
    for line in logs.must_exit_leaving(0).json_lines() {
        let text = line["text"].as_str().unwrap().trim();
        let said: f64 = text.split(' ').next().unwrap().parse().unwrap();
        let read = line["at_s"].as_f64().unwrap();
        assert!(said <= read + 0.1, "{line}");
    }
    run.signal(Signal::INT);
    run.end().must_exit(130);
    on_x.wait_for("over     pair: the boot has ended it");
    on_x.signal(Signal::KILL);
    on_x.end();
}
