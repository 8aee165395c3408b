//! What the page tells beside the drawing of a net: tasks and their messages, lanes, places of several nets,
//! breakpoints at places, and what it does not know any more.

use ctos::time::Clock;
use rustix::process::Signal;

use super::{DISPATCHER, SIZE, SLOW, boot, browser::Browser, choose, pictures, scratch};

#[test]
#[ignore = "needs Chromium"]
fn a_transition_leads_to_the_last_messages_of_its_task_whoever_sent_them_and_back() {
    let scratch = scratch();
    // It waits after the first round, in which every coordinator was asked.
    let waits = "task.dispatcher.args.breakpoints=[\"init_calib\", \"loop_again\"]";
    let (run, page) = boot(&scratch, &["--set", waits, "--record", "run.mcap"]);
    let mut browser = Browser::open(&format!("{page}#net=dispatcher"), SIZE);
    browser.wait(&format!("{DISPATCHER}.head.paused !== null"));
    // A task that no net calls is found by its name; what it handles is kept from now on.
    browser.ask("nets.find('mcs')");
    browser.wait("document.querySelector('#side h2').textContent.startsWith('mcs')");
    browser.wait("nets.tasks.get('mcs')?.now !== null && nets.tasks.has('mcs')");
    choose(&mut browser, "init_calib");
    browser.click("Breakpoint");
    browser.click("Release net");
    browser.wait(&format!("{DISPATCHER}.head.paused?.includes('loop_again')"));

    // The coordinator that a request goes to: what it was asked, by whom, and how that ended.
    choose(&mut browser, "move_robot");
    browser.wait("nets.tasks.get('motion')?.messages.some((one) => one.from === 'dispatcher')");
    browser.wait(
        "document.querySelector('#side .messages li').textContent.includes('from dispatcher')",
    );
    // What is sent because somebody looks on is not among them.
    assert_eq!(
        browser.ask("nets.tasks.get('motion').messages.some((one) => one.command === 'follow')"),
        false
    );

    // One that others than nets send to.
    browser.ask("nets.find('mcs')");
    browser.wait("document.querySelector('#side h2').textContent.startsWith('mcs')");
    browser.wait("nets.tasks.get('mcs')?.messages.length > 0 && nets.tasks.get('mcs').messages.every((one) => one.command !== '' && one.from !== '')");
    browser.wait("document.querySelector('#side .messages li')");
    browser.wait("nets.tasks.get('mcs').now.handled > 0");
    pictures(&mut browser, "task");

    // What the log says of a task stands below.
    browser.ask("nets.lookAt('display')");
    browser.wait("document.querySelector('#side [aria-label=log] li')?.textContent.includes('nets are shown')");
    // Its address is there for viewers; what opens it for control is not.
    assert_eq!(
        browser.ask("nets.tasks.get('display').lines.some((one) => /token=\\w/.test(one.text))"),
        false
    );
    pictures(&mut browser, "log");
    browser.ask("nets.lookAt('mcs')");
    browser.wait("document.querySelector('#side h2').textContent.startsWith('mcs')");

    // A message leads to its moment, and the task to its callers.
    browser.ask("document.querySelector('#side .messages li button').click()");
    browser.wait("nets.cursor !== null");
    browser.click("Live");
    browser.ask("nets.lookAt('motion')");
    browser.wait("document.querySelector('#side h2').textContent.startsWith('motion')");
    browser.click("move_robot");
    browser.wait("nets.chosen === 'dispatcher/move_robot'");
    assert_eq!(browser.complaints, Vec::<String>::new());

    // The record knows the same.
    drop(browser);
    run.signal(Signal::INT);
    run.end();
    let export = [
        "display",
        "run.ws1.mcap",
        "run.cage_motion.mcap",
        "--export",
        "run.html",
    ];
    scratch.ctos(&export).must_exit(0);
    let file = format!("file://{}", scratch.path("run.html").display());
    let mut browser = Browser::open(&format!("{file}#net=dispatcher"), SIZE);
    browser.wait("nets.tasks.get('motion')?.messages.some((one) => one.from === 'dispatcher')");
    browser.ask("nets.goTo(nets.span()[1])");
    browser.ask("nets.lookAt('motion')");
    browser.wait(
        "document.querySelector('#side .messages li').textContent.includes('from dispatcher')",
    );
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[test]
#[ignore = "needs Chromium"]
fn lanes_are_those_of_transitions_or_of_the_tasks_that_they_ask() {
    let scratch = scratch();
    let (_run, page) = boot(&scratch, &[]);
    let mut browser = Browser::open(&format!("{page}#net=dispatcher"), SIZE);
    browser.wait(&format!(
        "{DISPATCHER}.head.ended.reduce((a, b) => a + b) > 12"
    ));
    browser.wait("nets.lanes.rows.some((row) => row.name === 'move_robot')");
    // What every request did is there again in the lane of its task, and of nothing else.
    let bars = "const bars = () => { nets.lanes.draw(); return nets.lanes.rows; };";
    let same = format!(
        "(() => {{ {bars} const by = {DISPATCHER}.view.transitions; const task = (name) => {{ const one = by.find((one) => one.shown === name); return one.task ?? (one.target === '' ? null : 'dispatcher'); }}; \
         const counts = (rows, name) => rows.reduce((all, row) => {{ const key = name(row); if (key !== null) all[key] = (all[key] ?? 0) + row.bars.length; return all; }}, {{}}); \
         const each = counts(bars(), (row) => task(row.name)); document.querySelector('#by-task').click(); \
         const all = counts(bars(), (row) => row.task); return JSON.stringify(Object.entries(each).sort()) === JSON.stringify(Object.entries(all).sort()) && Object.keys(all).length > 1; }})()"
    );
    assert_eq!(browser.ask(&same), true);
    assert_eq!(
        browser.ask("document.querySelector('#by-task').getAttribute('aria-pressed')"),
        "true"
    );
    // No two bars of a lane lie on each other where requests come one after the other.
    browser.wait("nets.lanes.rows.find((row) => row.name === 'motion')?.bars.some((bar) => bar.to > bar.from)");
    pictures(&mut browser, "lanes");
    // A click on the name of a lane leads to its task.
    browser.click_at("#lanes canvas", (20.0, 12.0));
    browser.wait("nets.task !== null && nets.task === nets.lanes.rows[0].task");
    browser.wait("document.querySelector('#side h2').textContent.startsWith(nets.task)");
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[test]
#[ignore = "needs Chromium"]
fn a_place_of_several_nets_is_one_place_with_ways_to_all_of_them() {
    let scratch = scratch();
    scratch.write(
        "configs/displays.toml",
        "[display.both]\nshow = [\"dispatcher/*\", \"motion/*\"]\n",
    );
    let displays = "task.display.args.displays=\"displays.toml\"";
    let waits = "task.dispatcher.args.breakpoints=[\"init_calib\"]";
    let (_run, page) = boot(&scratch, &["--set", displays, "--set", waits]);
    let mut browser = Browser::open(&format!("{page}#net=dispatcher"), SIZE);
    browser.wait("nets.picture.nodes.has('dispatcher/move_robot')");
    // In the net that sends, the place of the other one stands at its edge.
    browser.click("Detail");
    let remote = "[...nets.picture.nodes.values()].find((one) => one.kind === 'remote' && one.node.kind.remote[0] === 'motion')";
    browser.wait(remote);
    let place = browser.ask(&format!("{remote}.node.kind.remote[1]"));
    let place = place.as_str().unwrap().to_owned();
    browser.ask(&format!("nets.choose({remote}.key)"));
    browser.click("Show net motion");
    // There it is the place itself, which knows who puts tokens into it, and leads back.
    browser.wait(&format!(
        "nets.shown === 'motion' && nets.chosen === 'motion/{place}'"
    ));
    browser.wait("document.querySelector('#side').textContent.includes('put from')");
    browser.ask("[...document.querySelectorAll('#side .link')].find((one) => one.textContent.startsWith('dispatcher/')).click()");
    browser.wait("nets.shown === 'dispatcher' && nets.chosen.startsWith('dispatcher/')");
    // On a display of both it is there once, and arcs of both nets meet in it.
    browser.ask("nets.open('both', null)");
    let key = format!("motion/{place}");
    browser.wait(&format!("nets.picture.nodes.has('{key}')"));
    let once = format!(
        "nets.picture.arcs.some((arc) => arc.to === '{key}' && arc.from.startsWith('dispatcher/')) && nets.picture.arcs.some((arc) => arc.from === '{key}' && arc.to.startsWith('motion/')) \
         && ![...nets.picture.nodes.values()].some((one) => one.kind === 'remote' && one.node.kind.remote.join('/') === '{key}')"
    );
    pictures(&mut browser, "both");
    assert_eq!(browser.ask(&once), true);
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[test]
#[ignore = "needs Chromium"]
fn what_a_person_looks_at_stays_when_the_nets_come_anew() {
    let scratch = scratch();
    let waits = "task.dispatcher.args.breakpoints=[\"init_calib\"]";
    let (_run, page) = boot(&scratch, &["--set", waits]);
    let mut browser = Browser::open(&format!("{page}#net=dispatcher"), SIZE);
    browser.wait(&format!("{DISPATCHER}.head.paused !== null"));
    browser.click("Release net");
    browser.wait(&format!("{DISPATCHER}.head.seq > 20"));
    browser.ask("nets.choose('dispatcher/move_robot')");
    browser.ask(&format!("nets.goToEvent({DISPATCHER}, 8)"));
    browser.ask("nets.picture.zoom(1.5)");
    let seen = "JSON.stringify([nets.shown, nets.chosen, nets.cursor.at_ns, nets.picture.box, location.hash])";
    let before = browser.ask(seen);
    // As when the network was away for a moment, or a net was started on another chassis.
    browser.ask("(() => { globalThis.was = nets.nets.get('dispatcher'); nets.socket.close(); })()");
    browser.wait(&format!(
        "{DISPATCHER} !== undefined && {DISPATCHER} !== was && nets.picked"
    ));
    assert_eq!(browser.ask(seen), before);
    let marked = format!(
        "nets.visibleNets()[0] === {DISPATCHER} && nets.stateOf({DISPATCHER}).at_ns <= nets.cursor.at_ns"
    );
    assert_eq!(browser.ask(&marked), true);
    browser.wait("document.querySelector('#side h2').textContent.startsWith('move_robot')");
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[test]
#[ignore = "needs Chromium"]
fn a_breakpoint_at_a_place_waits_for_what_its_form_says() {
    let scratch = scratch();
    let waits = "task.dispatcher.args.breakpoints=[\"init_calib\"]";
    let (_run, page) = boot(&scratch, &["--set", waits]);
    let mut browser = Browser::open(&format!("{page}#net=isle"), SIZE);
    browser.wait("nets.picture.nodes.has('isle/rest')");
    browser.ask("nets.choose('isle/rest')");
    browser.wait("document.querySelector('#side form.predicate')");
    // As a person fills it in; nothing that goes on meanwhile takes it away.
    browser.ask("(() => { const [sign, tokens] = document.querySelectorAll('#side .predicate select, #side .predicate input'); tokens.focus(); globalThis.typed = tokens; })()");
    for (name, value) in [("sign", "="), ("tokens", "3")] {
        browser.ask(&format!("(() => {{ const one = document.querySelector('#side .predicate [name={name}]'); one.focus(); one.value = {value:?}; one.dispatchEvent(new Event('change', {{ bubbles: true }})); }})()"));
    }
    browser.ask("nets.panels()");
    assert_eq!(browser.ask("typed.isConnected && typed.value"), "3");
    browser.click("Set");
    browser.wait("document.querySelector('[data-key=\"isle/rest\"].armed')");
    assert!(
        scratch
            .read("configs/nets/isle.breaks.toml")
            .contains("\"rest=3\"")
    );
    // Two tokens are not three.
    let isle = "nets.nets.get('isle')";
    browser.click("Put a token");
    browser.wait(&format!("{isle}.head.places[0] === 2"));
    assert_eq!(
        browser.ask(&format!("{isle}.head.paused")),
        serde_json::Value::Null
    );
    pictures(&mut browser, "predicate");
    browser.click("Put a token");
    browser.wait(&format!("{isle}.head.paused === 'breakpoint `rest=3`'"));
    // Each is cleared by itself.
    browser.click("rest=3 ✕");
    browser.wait("!document.querySelector('[data-key=\"isle/rest\"].armed')");
    assert!(!scratch.path("configs/nets/isle.breaks.toml").exists());
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[test]
#[ignore = "needs Chromium"]
fn a_page_that_has_forgotten_the_oldest_events_says_so_and_shows_the_rest_exactly() {
    let scratch = scratch();
    let waits = "task.dispatcher.args.breakpoints=[\"init_calib\"]";
    let (_run, page) = boot(&scratch, &["--set", waits]);
    let mut browser = Browser::open(&format!("{page}#net=dispatcher"), SIZE);
    browser.wait(&format!("{DISPATCHER}.head.paused !== null"));
    assert_eq!(browser.ask("document.querySelector('#older').hidden"), true);
    // The net waits: these events are the only ones that come.
    browser.ask(&format!(
        "(() => {{ const net = {DISPATCHER}; const last = {{ net: net.name, seq: net.head.seq, at_ns: net.head.at_ns, sent: [], data: [], target: '', trace: '' }}; const first = net.view.places[0].name; const events = []; \
         for (let n = 1; n <= 21000; n += 1) events.push({{ ...last, seq: last.seq + n, at_ns: last.at_ns + n * 1000, transition: '', firing: null, read: null, wrote: null, text: '', \
           phase: n % 2 === 1 ? 'put' : 'taken', produced: n % 2 === 1 ? [[first, 1]] : [], consumed: n % 2 === 1 ? [] : [[first, 1]] }}); \
         globalThis.was = net.head.places[0]; nets.take({{ kind: 'events', net: net.name, events }}); }})()"
    ));
    browser.wait("!document.querySelector('#older').hidden");
    let told = browser.ask("document.querySelector('#older').textContent");
    let forgotten = browser.ask(&format!("{DISPATCHER}.base.seq"));
    assert!(
        told.as_str()
            .unwrap()
            .starts_with(&format!("{forgotten} earlier events")),
        "{told}"
    );
    // The first moment that is left is the one that the net had.
    browser.ask("(() => { const scrub = document.querySelector('#scrub'); scrub.value = 0; scrub.dispatchEvent(new Event('input')); })()");
    let at = format!(
        "(() => {{ const net = {DISPATCHER}; const seen = nets.stateOf(net); return [seen.seq - net.base.seq, seen.places[0] - was - (seen.seq - (net.head.seq - 21000)) % 2, net.head.seq - net.events.length - net.base.seq]; }})()"
    );
    assert_eq!(browser.ask(&at), serde_json::json!([0, 0, 0]));
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[test]
#[ignore = "needs Chromium"]
fn breakpoints_of_the_boot_are_marked_and_the_clock_is_that_of_the_app_whoever_comes_when() {
    let scratch = scratch();
    let waits = "task.dispatcher.args.breakpoints=[\"init_calib\", \"loop_again\", \"move_robot\"]";
    let (_run, page) = boot(&scratch, &["--set", waits]);
    let page = format!("{page}#net=dispatcher");
    let mut browser = Browser::open(&page, SIZE);
    browser.wait(&format!("{DISPATCHER}.head.paused !== null"));
    for transition in ["init_calib", "loop_again", "move_robot"] {
        browser.wait(&format!(
            "document.querySelector('[data-key=\"dispatcher/{transition}\"].armed')"
        ));
    }
    // Nothing happens, and time goes by: also for a page that is opened only now.
    let waited = format!("nets.now() - {DISPATCHER}.head.at_ns");
    browser.wait(&format!("{waited} > 2e9"));
    let mut late = Browser::open(&page, SIZE);
    late.wait(&format!("{DISPATCHER}?.head.paused"));
    assert_eq!(late.ask(&format!("{waited} > 2e9")), true);
    // Another run of the app has another clock.
    late.ask("nets.take({ kind: 'hello', app: 'again', mode: 'live', control: false, displays: [], nets: [], tasks: [], handles: [] })");
    assert_eq!(late.ask("nets.offset === null"), true);
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[test]
#[ignore = "needs Chromium"]
fn an_open_page_goes_by_the_clock_of_an_app_that_is_booted_again_beneath_it() {
    let scratch = scratch();
    let waits = "task.dispatcher.args.breakpoints=[\"init_calib\"]";
    let boot = |display: &str| {
        let arguments = [&[display], &SLOW[..], &["--set", waits]].concat();
        let mut run = scratch.start_boot(&arguments);
        let line = run.line_with("nets are shown");
        let (_, page) = line.split_once("page=\"").unwrap();
        (run, page.split('"').next().unwrap().to_owned())
    };
    let (run, page) = boot("--display=127.0.0.1:0");
    let mut browser = Browser::open(&format!("{page}#net=dispatcher"), SIZE);
    browser.wait(&format!("{DISPATCHER}?.head.paused"));
    browser.ask(&format!("{DISPATCHER}.isOfTheFirst = true"));
    run.signal(Signal::INT);
    run.end().must_exit(130);

    let address = page.trim_start_matches("http://").trim_end_matches('/');
    let clock = Clock::real();
    let booted = clock.now();
    let (mut again, _) = boot(&format!("--display={address}"));
    again.wait_for(&format!("display  {page}"));
    browser.wait(&format!(
        "!{DISPATCHER}?.isOfTheFirst && {DISPATCHER}?.head.paused"
    ));
    let now = browser.ask("nets.now()").as_f64().unwrap();
    let age = clock.now().since(booted).as_nanos() as f64;
    assert!(0.0 < now && now <= age, "{now} ns, {age} ns after its boot");
}
