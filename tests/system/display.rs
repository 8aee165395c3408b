//! The net display in a real browser, at running calibrations. Chromium must be there, so these tests are
//! left out unless they are asked for: `cargo test -p system-tests display:: -- --ignored`.
//!
//! `CTOS_OVERVIEW=docs/overview.png` writes the picture of the README on the way, and `CTOS_PICTURE=docs/display.png` that of
//! the page about displays.

mod browser;
mod checkers;
mod command;
mod data;
mod fleet;
mod handles;
mod layers;
mod looking;
mod numbers;
mod panel;
mod scene;
mod standing;

use browser::Browser;

use crate::harness::{CTOS, Run, Scratch};

const SIZE: (u32, u32) = (1440, 900);

/// A browser beside an app makes a machine slow: nobody is given up because of that.
const SLOW: [&str; 4] = [
    "--set",
    "app.phase_timeout_s=90",
    "--set",
    "app.peer_timeout_s=60",
];

/// The calibration with a display, and one net more on a chassis of its own that is started again.
fn scratch() -> Scratch {
    let scratch = Scratch::short();
    scratch.write(
        "configs/nets/isle.net",
        "net isle\nplace rest = 1\ncommand go -> gone\ntransition turn\n  in rest\n  tape go\n  out rest\n  write gone\n",
    );
    let config = scratch.read("configs/calibrate.toml");
    let isle = "[chassis.isle]\nrestart = \"always\"\n[task.isle]\nhandler = \"coordinators.vision\"\non = \"isle\"\n[task.isle.args]\nnet = \"nets/isle.net\"\ncameras = [\"ceiling_west\"]\nretries = 1\n\n# -- Coordination Level";
    let config = config.replacen("# -- Coordination Level", isle, 1);
    scratch.write("configs/calibrate.toml", config);
    scratch
}

/// The address of a page with its token, from the file that a line of the log names.
fn opened(line: &str) -> String {
    let (_, file) = line.split_once("open=").unwrap();
    let file = file.split([' ', '\n', '\u{1b}']).next().unwrap();
    let text = std::fs::read_to_string(file).unwrap_or_else(|error| panic!("{file}: {error}"));
    let (_, url) = text.split_once("url=").unwrap();
    url.split('"').next().unwrap().to_owned()
}

/// Boots it; the address of the page.
fn boot<'a>(scratch: &'a Scratch, sets: &[&str]) -> (Run<'a>, String) {
    let display = [&["--display=127.0.0.1:0", "--allow-control"], &SLOW[..]].concat();
    let mut run = scratch.start_boot(&[&display[..], sets].concat());
    let line = run.line_with("nets are shown");
    let page = opened(&line);
    (run, page)
}

/// Boots another app of the configurations with a display; the address of its page.
fn boot_app<'s>(scratch: &'s Scratch, config: &str, more: &[&str]) -> (Run<'s>, String) {
    let display = ["boot", config, "--display=127.0.0.1:0", "--allow-control"];
    let mut run = scratch.start(CTOS, &[&display[..], &SLOW, more].concat(), &[]);
    let line = run.line_with("nets are shown");
    let page = opened(&line);
    (run, page)
}

const DISPATCHER: &str = "nets.nets.get('dispatcher')";

/// Takes pictures of a page, for a person to look at: `CTOS_PICTURES` is the folder. In light and dark colours, and
/// narrow.
fn pictures(browser: &mut Browser, name: &str) {
    let Some(folder) = std::env::var_os("CTOS_PICTURES").map(std::path::PathBuf::from) else {
        return;
    };
    for scheme in ["light", "dark"] {
        browser.prefer(&[("prefers-color-scheme", scheme)]);
        browser.picture(&folder.join(format!("{name}-{scheme}.png")));
    }
    browser.resize((420, 1400));
    browser.picture(&folder.join(format!("{name}-narrow.png")));
    browser.prefer(&[]);
    browser.resize(SIZE);
}

#[test]
#[ignore = "needs Chromium"]
fn a_person_watches_stops_scrubs_and_releases_a_running_calibration() {
    let scratch = scratch();
    // Who looks back to the beginning must have been there: the net waits before its first firing.
    let waits = "task.dispatcher.args.breakpoints=[\"init_calib\"]";
    let (_run, page) = boot(&scratch, &["--set", waits]);
    let mut browser = Browser::open(&format!("{page}#net=dispatcher"), SIZE);
    let state = |name: &str| {
        format!("document.querySelector('[data-key=\"dispatcher/{name}\"]').dataset.state")
    };
    browser.wait(&format!("{DISPATCHER}.head.paused !== null"));
    browser.click("Release net");

    // Tokens move: the robot goes, arrives, and both requests are under way at once.
    browser.wait(&format!("{} === 'running'", state("move_robot")));
    browser.wait("document.querySelector('[data-key=\"dispatcher/robot_available\"]').dataset.tokens === '0'");
    let before = browser.ask(&format!("{DISPATCHER}.head.ended.reduce((a, b) => a + b)"));
    browser.wait(&format!(
        "{DISPATCHER}.head.ended.reduce((a, b) => a + b) > {before} + 8"
    ));
    browser.wait("document.querySelectorAll('#events tbody tr').length > 20");
    if let Some(picture) = std::env::var_os("CTOS_PICTURE") {
        browser.wait(&format!(
            "{} === 'running' && nets.now() - {DISPATCHER}.head.at_ns > 4e8",
            state("move_robot")
        ));
        choose(&mut browser, "move_robot");
        browser.wait("document.querySelector('#side .words.running')");
        browser.picture(picture.as_ref());
    }

    // A breakpoint stops the net, and says where.
    choose(&mut browser, "read_next_pos");
    browser.click("Breakpoint");
    browser.wait("document.querySelector('[data-key=\"dispatcher/read_next_pos\"].armed')");
    browser.wait(&format!("{DISPATCHER}.head.paused !== null"));
    browser.wait("document.querySelector('#status').textContent.includes('stands still')");
    browser.wait(&format!("{} === 'enabled'", state("read_next_pos")));

    // Meanwhile an earlier moment is looked at: there the resources had not been taken.
    let now = browser.ask(&format!("{DISPATCHER}.head.places.join()"));
    browser.ask("(() => { const scrub = document.querySelector('#scrub'); scrub.value = 0; scrub.dispatchEvent(new Event('input')); })()");
    browser.wait("document.querySelector('[data-key=\"dispatcher/robot_available\"]').dataset.tokens === '1'");
    browser.wait("document.querySelector('#status').textContent.includes('looking back')");
    let then = browser.ask(&format!("nets.stateOf({DISPATCHER}).places.join()"));
    assert_ne!(now, then);
    // Event by event, every marking on the way to the present is the one that the net had.
    let same = format!(
        "(() => {{ const net = {DISPATCHER}; return net.events.length > 10 && net.stateAt(net.events.length - 1) !== net.head \
         && net.kept.every((one) => JSON.stringify(net.stateAt(one.position).places) === JSON.stringify(one.position >= net.events.length ? net.head.places : one.state.places)); }})()"
    );
    assert_eq!(browser.ask(&same), true);
    browser.click("Live");
    browser.wait("document.querySelector('[data-key=\"dispatcher/robot_available\"]').dataset.tokens === '0'");

    // Released, it goes on.
    choose(&mut browser, "read_next_pos");
    browser.click("Breakpoint");
    browser.wait("!document.querySelector('[data-key=\"dispatcher/read_next_pos\"].armed')");
    browser.click("Release net");
    browser.wait(&format!(
        "{DISPATCHER}.head.paused === null && {} !== 'enabled'",
        state("read_next_pos")
    ));
    let before = browser.ask(&format!("{DISPATCHER}.head.seq"));
    browser.wait(&format!("{DISPATCHER}.head.seq > {before} + 10"));
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[test]
#[ignore = "needs Chromium"]
fn the_page_tells_in_a_line_why_the_whole_waits_and_shows_nets_side_by_side() {
    let scratch = scratch();
    let (_run, page) = boot(&scratch, &[]);
    let mut browser = Browser::open(&format!("{page}#net=dispatcher"), SIZE);
    // While the arm moves: through nets and tasks to the task that works, and how long that will
    // take.
    let why = "document.querySelector('#why').textContent";
    browser.wait(&format!(
        "/^dispatcher waits for motion, which waits for mcs, which waits for .*planner, which moves the arm: [0-9.]+ s to go$/.test({why})"
    ));
    // Its token is shown where it is.
    let held = "getComputedStyle(document.querySelector('[data-key=\"dispatcher/move_robot\"] .held')).display";
    browser.wait(&format!("{held} === 'block'"));
    // The table fits its window, with words in every column.
    browser.wait("document.querySelectorAll('#events tbody tr').length > 20");
    let fits = "(() => { const table = document.querySelector('#events .table'); return table.scrollWidth <= table.clientWidth; })()";
    assert_eq!(browser.ask(fits), true);
    // A request has its author's name there, and what happened to it.
    let names = "[...document.querySelectorAll('#events tbody tr')].map((row) => [2, 3].map((at) => row.children[at].textContent).join(' '))";
    browser.wait(&format!("{names}.includes('move_robot started')"));
    assert_eq!(
        browser.ask(&format!(
            "{names}.filter((name) => /^(start|end|fail)_/.test(name))"
        )),
        serde_json::json!([])
    );

    // Nor is it shown what a request is made of, unless that is wanted.
    let moved = "[...document.querySelectorAll('#events tbody tr')].map((row) => row.children[4].textContent).join(' ')";
    assert_eq!(
        browser.ask(&format!("/S[IO]_|_active/.test({moved})")),
        false
    );

    let nets = "new Set([...nets.picture.nodes.values()].map((one) => one.net.name)).size";
    browser.click("Beside");
    browser.wait(&format!("{nets} === nets.nets.size"));
    browser.wait("document.querySelector('#beside').getAttribute('aria-pressed') === 'true'");
    // No net is drawn over another one.
    let apart = "(() => { const boxes = nets.displays.find((one) => one.paned).parts.map(({ drawing: { nodes } }) => ['x', 'y'].map((way) => [Math.min, Math.max].map((most) => most(...nodes.map((node) => node[way]))))); \
         return boxes.every((one, at) => boxes.every((other, of) => at === of || [0, 1].some((way) => one[way][1] < other[way][0] || other[way][1] < one[way][0]))); })()";
    assert_eq!(browser.ask(apart), true);
    pictures(&mut browser, "beside");
    browser.click("Beside");
    browser.wait(&format!("{nets} === 1"));
    browser.ask("(() => { const tabs = [...document.querySelectorAll('#tabs button')]; tabs.find((one) => one.textContent === 'motion').dispatchEvent(new MouseEvent('click', { shiftKey: true })); })()");
    browser.wait("nets.shown === 'dispatcher+motion'");
    // A link leads there again.
    browser.wait("location.hash.includes('net=dispatcher')");
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[test]
#[ignore = "needs Chromium"]
fn a_net_whose_chassis_is_killed_is_shown_as_gone_and_comes_back() {
    let scratch = scratch();
    // Without a chassis the arm is stopped, and the calibration fails: it waits before its first firing.
    let waits = "task.dispatcher.args.breakpoints=[\"init_calib\"]";
    let (run, page) = boot(&scratch, &["--set", waits]);
    let mut browser = Browser::open(&format!("{page}#net=isle"), SIZE);
    browser.wait("document.querySelector('[data-key=\"isle/rest\"]').dataset.tokens === '1'");
    browser.wait("document.querySelector('#status').textContent === 'live'");
    run.kill("isle");
    browser.wait("nets.nets.get('isle').gone !== null");
    browser.wait("document.querySelector('#status').textContent === 'isle is gone'");
    browser.wait("document.querySelector('[data-key=\"isle/rest\"].gone')");
    browser.wait("nets.nets.get('isle').gone === null");
    browser.wait("document.querySelector('#status').textContent === 'live'");
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[test]
#[ignore = "needs Chromium"]
fn keys_alone_lead_through_the_page_and_a_narrow_one_has_everything() {
    let scratch = scratch();
    let (_run, page) = boot(&scratch, &[]);
    let mut browser = Browser::open(&format!("{page}#net=dispatcher"), (420, 900));
    browser.wait("nets.picture.nodes.size > 20");
    let press = |browser: &mut Browser, key: &str| {
        browser.ask(&format!("document.body.dispatchEvent(new KeyboardEvent('keydown', {{ key: {key:?}, bubbles: true }}))"));
    };
    press(&mut browser, "ArrowRight");
    browser.wait("nets.chosen !== null");
    let first = browser.ask("nets.chosen");
    press(&mut browser, "ArrowRight");
    assert_ne!(browser.ask("nets.chosen"), first);
    press(&mut browser, "]");
    assert_ne!(browser.ask("nets.shown"), "dispatcher");
    press(&mut browser, " ");
    browser.wait("nets.cursor !== null");
    press(&mut browser, "l");
    browser.wait("nets.cursor === null");
    press(&mut browser, "d");
    assert_eq!(browser.ask("nets.detail"), "full");
    // Nothing stands beyond the edge.
    assert_eq!(
        browser.ask("document.documentElement.scrollWidth <= innerWidth"),
        true
    );
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[test]
#[ignore = "needs Chromium"]
fn whoever_has_no_token_or_comes_from_elsewhere_may_not_intervene() {
    let scratch = scratch();
    let (_run, page) = boot(&scratch, &[]);
    let (bare, _) = page.split_once('?').unwrap();
    let mut browser = Browser::open(&format!("{bare}#net=dispatcher"), SIZE);
    browser.wait("nets.picture.nodes.size > 20");
    assert_eq!(browser.ask("nets.control"), false);
    browser.ask("nets.order('pause', nets.nets.get('dispatcher'), {})");
    browser.wait("document.querySelector('#banner').textContent.includes('may only look on')");
    // What is no message ends this one connection, with a reason; the page connects again.
    browser.ask("(() => { globalThis.ended = null; nets.socket.addEventListener('close', (event) => { globalThis.ended = event; }); nets.socket.send('{'); })()");
    browser.wait("ended.code === 1008 && ended.reason.includes('cannot be read')");
    browser.ask("new Promise((done) => { const look = () => nets.socket.readyState === 1 && !nets.lost ? done() : setTimeout(look, 20); look(); })");
    // Another origin, and a name that only seems to be this host's.
    let refused = |header: &str| {
        let host = bare.trim_start_matches("http://").trim_end_matches('/');
        let request = format!(
            "GET /ws HTTP/1.1\r\n{}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n",
            header.replace("HERE", host)
        );
        let mut stream = std::net::TcpStream::connect(host).unwrap();
        std::io::Write::write_all(&mut stream, request.as_bytes()).unwrap();
        let mut line = String::new();
        std::io::BufRead::read_line(&mut std::io::BufReader::new(stream), &mut line).unwrap();
        line
    };
    assert!(refused("Host: HERE\r\nOrigin: http://elsewhere.example").contains(" 403 "));
    assert!(refused("Host: elsewhere.example:80").contains(" 403 "));
    assert!(refused("Host: HERE\r\nOrigin: http://HERE").contains(" 101 "));
}

#[test]
#[ignore = "needs Chromium"]
fn what_a_person_moves_stays_there_for_everybody_and_nothing_else_ever_moves() {
    let scratch = scratch();
    scratch.write(
        "configs/displays.toml",
        "[display.arm]\ntitle = \"The arm\"\nshow = [\"dispatcher/move_*\", \"motion/*\", \"dispatcher/typo\"]\n",
    );
    let displays = "task.display.args.displays=\"displays.toml\"";
    let waits = "task.dispatcher.args.breakpoints=[\"init_calib\"]";
    let (run, page) = boot(&scratch, &["--set", displays, "--set", waits]);
    let spots = "JSON.stringify([...nets.picture.nodes.values()].map((one) => [one.key, one.node.x, one.node.y]))";
    let spot = |key: &str| {
        format!("(({{ node }}) => [node.x, node.y].join())(nets.picture.nodes.get({key:?}))")
    };

    // The motion net has no layout file: its first arrangement is kept with the first node that is moved.
    let mut browser = Browser::open(&format!("{page}#net=motion"), SIZE);
    browser.wait("nets.picture.nodes.has('motion/move_manip')");
    let mut other = Browser::open(&format!("{page}#net=motion"), SIZE);
    other.wait("nets.picture.nodes.has('motion/move_manip')");
    // Where a node is dragged to is rounded, and kept so.
    let settled = |key: &str| {
        format!(
            "(({{ node }}) => Number.isInteger(node.x) && Number.isInteger(node.y))(nets.picture.nodes.get({key:?}))"
        )
    };
    let before = browser.ask(&spot("motion/move_manip"));
    let rest = browser.ask(&spot("motion/plan_path"));
    browser.drag("[data-key=\"motion/move_manip\"]", (60.0, 45.0));
    browser.wait(&format!("{} !== {before}", spot("motion/move_manip")));
    browser.wait(&settled("motion/move_manip"));
    let after = browser.ask(&spot("motion/move_manip"));
    other.wait(&format!("{} === {after}", spot("motion/move_manip")));
    assert_eq!(other.ask(&spot("motion/plan_path")), rest);
    let text = scratch.read("configs/nets/motion.layout.toml");
    assert!(
        text.contains("move_manip") && text.contains("plan_path"),
        "{text}"
    );

    // An overview draws the requests that go from net to net, and keeps its nodes in a file of its own.
    browser.ask("nets.open('arm', null)");
    browser.wait("nets.picture.nodes.has('dispatcher/move_robot')");
    browser.wait("nets.picture.arcs.some((arc) => arc.from === 'dispatcher/move_robot' && arc.to.startsWith('motion/'))");
    browser.wait("nets.picture.arcs.some((arc) => arc.from.startsWith('motion/') && arc.to === 'dispatcher/move_robot')");
    let key = "dispatcher/move_robot";
    let here = browser.ask(&spot(key));
    browser.drag(&format!("[data-key=\"{key}\"]"), (-20.0, 25.0));
    browser.wait(&format!("{} !== {here}", spot(key)));
    browser.wait(&settled(key));
    other.ask("nets.open('arm', null)");
    let here = browser.ask(&spot(key));
    other.wait(&format!("{} === {here}", spot(key)));
    let all = browser.ask(spots);
    assert_eq!(other.ask(spots), all);
    assert_eq!(browser.complaints, Vec::<String>::new());
    assert_eq!(other.complaints, Vec::<String>::new());
    drop((browser, other, run));

    // It is so in the next run too.
    let (_run, page) = boot(&scratch, &["--set", displays, "--set", waits]);
    let mut browser = Browser::open(&format!("{page}#net=arm"), SIZE);
    browser.wait("nets.picture.nodes.has('dispatcher/move_robot')");
    assert_eq!(browser.ask(spots), all);
    browser.ask("nets.open('motion', null)");
    assert_eq!(browser.ask(&spot("motion/move_manip")), after);
}

#[test]
#[ignore = "needs Chromium"]
fn a_breakpoint_set_on_the_page_holds_the_next_run_before_its_first_firing() {
    let scratch = scratch();
    let waits = "task.dispatcher.args.breakpoints=[\"init_calib\"]";
    let (run, page) = boot(&scratch, &["--set", waits]);
    let mut browser = Browser::open(&format!("{page}#net=dispatcher"), SIZE);
    browser.wait("nets.picture.nodes.has('dispatcher/read_next_pos')");
    choose(&mut browser, "read_next_pos");
    browser.click("Breakpoint");
    browser.wait("document.querySelector('[data-key=\"dispatcher/read_next_pos\"].armed')");
    let text = scratch.read("configs/nets/dispatcher.breaks.toml");
    assert!(
        text.contains("\"read_next_pos\"") && !text.contains("init_calib"),
        "{text}"
    );
    drop((browser, run));

    let (_run, page) = boot(&scratch, &[]);
    let mut browser = Browser::open(&format!("{page}#net=dispatcher"), SIZE);
    browser.wait(&format!("{DISPATCHER}.head.paused !== null"));
    let fired =
        format!("{DISPATCHER}.head.ended[{DISPATCHER}.index.transitions.get('read_next_pos')]");
    assert_eq!(browser.ask(&fired), 0);
    // Taken away, it is nowhere any more.
    choose(&mut browser, "read_next_pos");
    browser.click("Breakpoint");
    browser.wait("!document.querySelector('[data-key=\"dispatcher/read_next_pos\"].armed')");
    assert!(!scratch.path("configs/nets/dispatcher.breaks.toml").exists());
}

#[test]
#[ignore = "needs Chromium"]
fn a_person_plays_through_what_would_happen_and_nothing_of_it_does() {
    let scratch = scratch();
    let waits = "task.dispatcher.args.breakpoints=[\"init_calib\"]";
    let (_run, page) = boot(&scratch, &["--set", waits]);
    let mut browser = Browser::open(&format!("{page}#net=dispatcher"), SIZE);
    browser.wait(&format!("{DISPATCHER}.head.paused !== null"));
    let places = format!("{DISPATCHER}.head.places.join()");
    let real = browser.ask(&places);
    choose(&mut browser, "init_calib");
    browser.click("What if");
    browser
        .wait("document.querySelector('#status').textContent.includes('nothing of this happens')");
    // The buttons are those of the copy now.
    browser.wait("[...document.querySelectorAll('#side button')].some((one) => one.textContent === 'Take back')");
    browser.click("Fire");
    let fork = "nets.forks.get('dispatcher').head.places.join()";
    browser.wait(&format!("{fork} !== {real}"));
    assert_eq!(browser.ask(&places), real);
    browser.click("Take back");
    browser.wait(&format!("{fork} === {real}"));
    browser.click("What if");
    browser.wait("nets.forks.size === 0");
    // From a transition to its task, what nets asked of it, and back.
    browser.ask("nets.find('motion')");
    browser.ask("nets.lookAt('motion')");
    browser.wait("document.querySelector('#side h2').textContent.startsWith('motion')");
    browser.click("move_robot");
    browser.wait("nets.chosen === 'dispatcher/move_robot'");
    assert_eq!(browser.complaints, Vec::<String>::new());
}

/// A net of so many nodes, and one that fires a thousand times a second.
fn large(nodes: usize) -> (String, &'static str) {
    let count = nodes / 2;
    let mut text = "net large\n".to_owned();
    for index in 0..count {
        text += &format!("place p{index}{}\n", if index == 0 { " = 1" } else { "" });
    }
    for index in 0..count {
        let next = (index + 1) % count;
        text += &format!("transition t{index}\n  in p{index}\n  time 5 ms\n  out p{next}\n");
    }
    (
        text,
        "net fast\nplace a = 1, b\ntransition t\n  in a\n  time 1 ms\n  out b\ntransition u\n  in b\n  out a\n",
    )
}

/// How far the machine's clock, which events are stamped with, is ahead of the page's, ms; and how far that may be wrong.
fn clocks(browser: &mut Browser) -> (f64, f64) {
    let clock = ctos::time::Clock::real();
    let ms = |now: ctos::time::Instant| (clock.origin_ns().unwrap() + now.as_nanos()) as f64 / 1e6;
    let bounds = (0..20).map(|_| {
        let before = ms(clock.now());
        let page = browser.ask("performance.now()").as_f64().unwrap();
        let half = (ms(clock.now()) - before) / 2.0;
        (before + half - page, half)
    });
    bounds.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap()
}

/// Chooses a transition, and waits until the page tells about it.
fn choose(browser: &mut Browser, transition: &str) {
    browser.ask(&format!("nets.choose('dispatcher/{transition}')"));
    browser.wait(&format!(
        "document.querySelector('#side h2').textContent.startsWith('{transition}')"
    ));
}

/// The scratch folder's calibration with these nets besides.
fn with_nets(scratch: &Scratch, names: &[&str]) {
    let config = scratch.read("configs/calibrate.toml");
    let net = |name: &&str| {
        format!(
            "[chassis.{name}]\n[task.{name}]\nhandler = \"coordinators.vision\"\non = \"{name}\"\n[task.{name}.args]\nnet = \"nets/{name}.net\"\ncameras = [\"ceiling_west\"]\nretries = 1\n\n"
        )
    };
    let nets: String = names.iter().map(net).collect();
    scratch.write("configs/calibrate.toml", config + "\n" + &nets);
}

#[test]
#[ignore = "needs Chromium"]
fn a_breakpoint_of_a_large_net_is_seen_on_its_canvas_however_small_the_net_is_drawn() {
    let scratch = scratch();
    scratch.write("configs/nets/large.net", large(2_000).0);
    with_nets(&scratch, &["large"]);
    let waits = "task.dispatcher.args.breakpoints=[\"init_calib\"]";
    let (_run, page) = boot(&scratch, &["--set", waits]);
    let mut browser = Browser::open(&format!("{page}#net=large"), SIZE);
    browser.wait("nets.firstDrawn > 0 && nets.shown === 'large'");
    // Red at the centre of the mark of a node, on the canvas of breakpoints.
    let red = |node: &str, beside: &str| {
        format!(
            "(() => {{ const field = nets.picture.field, {{ node, kind }} = nets.picture.nodes.get('large/{node}'); \
             const [dx, dy] = {beside}, scale = field.scale * devicePixelRatio, canvas = field.canvases[2]; \
             const [x, y] = [(node.x + dx - field.box.x) * scale, (node.y + dy - field.box.y) * scale]; \
             const [r, g, , a] = canvas.getContext('2d').getImageData(Math.round(x), Math.round(y), 1, 1).data; \
             return a > 128 && r > 1.5 * g; }})()"
        )
    };
    let transition = red("t3", "node.lying ? [0, -12] : [-12, -20]");
    // Far away: in so small a drawing the marks of neighbours lie on one another.
    let place = red("p500", "[-14, -12]");
    assert_eq!(browser.ask(&transition), false);
    browser.ask("nets.order('break', nets.nets.get('large'), { transition: 't3' })");
    browser.wait(&transition);
    assert_eq!(browser.ask(&place), false);
    browser.ask("nets.order('break', nets.nets.get('large'), { place: 'p500' })");
    browser.wait(&place);
    pictures(&mut browser, "breakpoints-of-a-large-net");
    browser.ask("nets.order('clear', nets.nets.get('large'), { transition: 't3' })");
    browser.wait(&format!("!{transition}"));
    assert_eq!(browser.ask(&place), true);
    assert_eq!(browser.complaints, Vec::<String>::new());
}

/// Figures are printed, and none is asserted: they are another machine's to have.
#[test]
#[ignore = "needs Chromium"]
#[allow(clippy::print_stdout, reason = "figures, for whoever asks for them")]
fn a_large_net_and_a_fast_one_are_shown_while_they_fire() {
    let nodes = std::env::var("CTOS_NODES").map_or(500, |nodes| nodes.parse().unwrap());
    let scratch = scratch();
    let (large, fast) = large(nodes);
    scratch.write("configs/nets/large.net", large);
    scratch.write("configs/nets/fast.net", fast);
    with_nets(&scratch, &["large", "fast"]);
    let waits = "task.dispatcher.args.breakpoints=[\"init_calib\"]";
    let (_run, page) = boot(&scratch, &["--set", waits]);

    let mut browser = Browser::open(&format!("{page}#net=large"), SIZE);
    browser.wait("nets.firstDrawn > 0 && nets.shown === 'large'");
    let first = browser.ask("nets.firstDrawn");
    // Frames while it fires.
    let frames = browser.ask("new Promise((done) => { const gaps = []; let last = performance.now(); const frame = (now) => { gaps.push(now - last); last = now; if (gaps.length < 90) requestAnimationFrame(frame); else done(gaps.sort((a, b) => a - b)); }; requestAnimationFrame(frame); })");
    let before = browser.ask("nets.nets.get('large').head.seq");
    browser.wait(&format!("nets.nets.get('large').head.seq > {before}"));

    browser.ask("nets.open('fast', null)");
    browser.ask("(() => { globalThis.late = []; const take = nets.take.bind(nets); nets.take = (message) => { if (message.net === 'fast') for (const event of message.events ?? []) late.push(performance.now() - (nets.origin + event.at_ns) / 1e6); take(message); }; globalThis.begun = [performance.now(), nets.nets.get('fast').head.seq]; })()");
    browser.wait("late.length > 3000");
    let late = browser.ask("late.sort((a, b) => a - b)");
    let (ahead, unsure) = clocks(&mut browser);
    let rate = browser.ask(
        "(1000 * (nets.nets.get('fast').head.seq - begun[1])) / (performance.now() - begun[0])",
    );
    let at = |all: &serde_json::Value, share: f64| {
        let all = all.as_array().unwrap();
        all[((all.len() - 1) as f64 * share) as usize]
            .as_f64()
            .unwrap()
    };
    println!(
        "{nodes} nodes: first picture after {:.0} ms, frames every {:.1} ms (median), {:.1} ms (p95)",
        first.as_f64().unwrap(),
        at(&frames, 0.5),
        at(&frames, 0.95)
    );
    println!(
        "{:.0} events/s: from firing to browser {:.1} ms (median), {:.1} ms (p95), give or take {unsure:.1} ms",
        rate.as_f64().unwrap(),
        at(&late, 0.5) + ahead,
        at(&late, 0.95) + ahead
    );
    // Whatever was skipped, the marking is the net's.
    browser.wait("nets.nets.get('fast').head.places.reduce((a, b) => a + b) === 1");
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[test]
#[ignore = "needs Chromium"]
fn the_page_follows_what_a_person_has_told_the_system() {
    let scratch = scratch();
    let waits = "task.dispatcher.args.breakpoints=[\"init_calib\"]";
    let (_run, page) = boot(&scratch, &["--set", waits]);
    let mut browser = Browser::open(&format!("{page}#net=dispatcher"), SIZE);
    let ground = "getComputedStyle(document.body).backgroundColor";
    let pictures = std::env::var_os("CTOS_PICTURES").map(std::path::PathBuf::from);
    let picture = |browser: &mut Browser, name: &str| {
        if let Some(folder) = &pictures {
            browser.picture(&folder.join(name));
        }
    };
    browser.prefer(&[("prefers-color-scheme", "light")]);
    browser.wait(&format!("{DISPATCHER}.head.paused !== null"));
    let light = browser.ask(ground);
    picture(&mut browser, "light.png");
    browser.prefer(&[
        ("prefers-color-scheme", "dark"),
        ("prefers-reduced-motion", "reduce"),
    ]);
    browser.wait(&format!("{ground} !== {light}"));
    picture(&mut browser, "dark.png");

    // Nothing travels for those who want less motion, however much fires.
    choose(&mut browser, "init_calib");
    browser.click("Breakpoint");
    browser.click("Release net");
    let before = browser.ask(&format!("{DISPATCHER}.head.seq"));
    browser.wait(&format!("{DISPATCHER}.head.seq > {before} + 8"));
    assert_eq!(browser.ask("nets.picture.travellers.length"), 0);

    // On a narrow screen nothing has to be pushed sideways, and the net is still there.
    browser.resize((420, 800));
    browser.wait("document.documentElement.scrollWidth <= innerWidth");
    browser.wait("document.querySelector('[data-key=\"dispatcher/move_robot\"]')");
    picture(&mut browser, "narrow.png");
    browser.prefer(&[("forced-colors", "active")]);
    browser.resize(SIZE);
    picture(&mut browser, "forced.png");
    assert_eq!(browser.complaints, Vec::<String>::new());
}
