//! Panels of service objects in a real browser, at running calibrations.

use super::{SIZE, SLOW, browser::Browser, opened, pictures};
use crate::harness::{Run, Scratch};

/// The calibration with its panels, whose arm nobody else moves; the address of the page with its token.
fn boot(scratch: &Scratch) -> (Run<'_>, String) {
    let still = [
        "--set",
        "task.dispatcher.args.allow_control=true",
        "--set",
        "task.dispatcher.args.breakpoints=[\"init_calib\"]",
        "--set",
        "task.panel.args.listen=\"127.0.0.1:0\"",
        "--profile",
        "panel",
    ];
    let mut run = scratch.start_boot(&[&still[..], &SLOW[..]].concat());
    let line = run.line_with("a panel is served");
    let page = opened(&line);
    (run, page)
}

/// The control that a label is about.
fn labelled(name: &str) -> String {
    format!("document.querySelector('[aria-label=\"{name}\"]')")
}

/// Sets a control as a person does, who then leaves it.
fn set(browser: &mut Browser, name: &str, value: &str) {
    let control = labelled(name);
    browser.wait(&control);
    browser.ask(&format!(
        "(() => {{ const one = {control}; one.value = {value:?}; one.dispatchEvent(new Event('change', {{ bubbles: true }})); }})()"
    ));
}

/// The answer to the last line that a page asked.
const ANSWERED: &str = "document.querySelector('#log li .answer').textContent";

#[test]
#[ignore = "needs Chromium"]
fn sliders_and_options_of_a_panel_change_the_objects_of_a_running_app() {
    let scratch = Scratch::short();
    let (_run, page) = boot(&scratch);
    let mut browser = Browser::open(&page, SIZE);
    browser.wait("document.querySelector('#title').textContent === 'PUMA 560'");
    browser.wait("document.querySelector('#state').textContent === 'connected'");

    // The plot shows where the joints are; the sliders begin there.
    browser.wait("document.querySelectorAll('svg.plot path[d]').length === 6");
    let sliders = format!("Number({}.value) > 0.7", labelled("bend"));
    browser.wait(&sliders);
    pictures(&mut browser, "panel");

    // A slider without a button: the object says that it has the new value.
    set(&mut browser, "speed", "0.125");
    browser.wait(&format!("{ANSWERED} === 'done'"));
    let asked = |browser: &mut Browser, line: &str| {
        browser.ask(&format!(
            "fetch('ask', {{ method: 'POST', headers: {{ 'x-scott-token': location.hash.slice(1) }}, body: {line:?} }}).then((reply) => reply.json())"
        ))
    };
    let dump = asked(&mut browser, "mvpos CTRL -dump");
    assert!(
        dump["text"].as_str().unwrap().contains("-speed 0.125"),
        "{dump}"
    );

    // Sliders with a button move the arm there.
    set(&mut browser, "waist", "0.25");
    browser.click("Move");
    let waist = "Number(document.querySelector('.legend li').textContent.split(' ').at(-1))";
    browser.wait(&format!("Math.abs({waist} - 0.25) < 0.01"));

    // The other panel is made of the options of classes.
    browser.ask("document.querySelector('#tabs a:not([aria-current])').click()");
    browser.wait("document.querySelector('#title').textContent === 'Vision parameters'");
    browser.wait(&labelled("threshold"));
    pictures(&mut browser, "vision");
    set(&mut browser, "threshold", "77");
    browser.wait(&format!("{ANSWERED} === 'done'"));
    let dump = asked(&mut browser, "spot CTRL -dump");
    assert!(
        dump["text"].as_str().unwrap().contains("-threshold 77"),
        "{dump}"
    );
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[test]
#[ignore = "needs Chromium"]
fn a_panel_without_its_token_shows_the_objects_and_changes_nothing() {
    let scratch = Scratch::short();
    let (_run, page) = boot(&scratch);
    let (bare, _) = page.split_once('#').unwrap();
    let mut browser = Browser::open(bare, SIZE);
    browser.wait("document.body.classList.contains('look')");
    browser.wait("document.querySelector('#why').textContent !== ''");
    // What it reads is read: the plot goes on.
    browser.wait("document.querySelectorAll('svg.plot path[d]').length === 6");
    // A name in a legend hides its line, and asks nothing.
    let free = "[...document.querySelectorAll('main :is(button:not(.shows), input, select)')].filter((one) => !one.disabled).length";
    assert_eq!(browser.ask(free), 0);
    assert_eq!(
        browser.ask("document.querySelector('#line')"),
        serde_json::Value::Null
    );
    // A request all the same is refused.
    let refused = "fetch('ask', { method: 'POST', body: 'mvpos CTRL -speed 0.125' }).then((reply) => reply.ok)";
    assert_eq!(browser.ask(refused), false);
    // On a narrow screen nothing has to be pushed sideways.
    browser.resize((360, 800));
    browser.wait("document.documentElement.scrollWidth <= innerWidth");
}

/// The number that the first joint of the pendant shows, rad.
const FIRST: &str = "Number(document.querySelector('.axis-row .number').textContent.split(' ')[0])";

#[test]
#[ignore = "needs Chromium"]
fn a_teach_pendant_jogs_while_a_button_is_held_records_poses_goes_to_them_and_stops() {
    let scratch = Scratch::short();
    let (_run, page) = boot(&scratch);
    let mut browser = Browser::open(&page.replace("/#", "/?n=2#"), SIZE);
    browser.wait("document.querySelector('#title').textContent === 'Teach pendant: arm'");
    browser.wait("document.querySelectorAll('.axis-row').length === 12");
    let fact = |name: &str, value: &str| {
        format!(
            "[...document.querySelectorAll('.fact')].some((one) => one.textContent.startsWith('{name}') && one.querySelector('.shown').textContent === '{value}')"
        )
    };
    browser.wait(&fact("State", "cold"));
    browser.wait(&fact("Owner", "nobody"));

    // Held, the joint moves on; let go, it ends within a step.
    let before = browser.ask(FIRST).as_f64().unwrap();
    let on = "[aria-label=\"joint1 on\"]";
    browser.press(on, true);
    browser.wait(&format!("{FIRST} > {before} + 0.05"));
    browser.press(on, false);
    let then = browser.ask(FIRST).as_f64().unwrap();
    browser.wait("!document.querySelector('.held')");
    let still = format!(
        "(() => {{ const now = {FIRST}; if (window.was !== now) {{ window.was = now; window.since = performance.now(); }} return performance.now() - window.since > 1500; }})()"
    );
    browser.wait(&still);
    let jogged = browser.ask(FIRST).as_f64().unwrap();
    assert!(jogged - then < 0.065, "{then} {jogged}");
    browser.wait(&fact("Owner", "objects"));

    // What each tick left is drawn, and a line is hidden by a click on its name.
    let line = "document.querySelector('[aria-label=\"Position\"] path').getAttribute('d')";
    browser.wait(&format!("{line}?.length > 100"));
    browser.ask("document.querySelector('.legend button').click()");
    browser.wait(&format!("{line} === ''"));

    // A pose is kept in a file, shown, and gone to.
    set(&mut browser, "name of a pose", "here");
    browser.click("Record");
    browser.wait("document.querySelector('.poses .here .to').textContent === 'here'");
    let kept = scratch.read("configs/pendant.dict");
    assert!(
        kept.contains("position.arm.here ") && kept.starts_with("# For the teach pendant"),
        "{kept}"
    );
    pictures(&mut browser, "pendant");
    browser.click("Home");
    browser.wait(&format!("Math.abs({FIRST}) < 0.005"));
    browser.click("here");
    browser.wait(&format!("Math.abs({FIRST} - {jogged}) < 0.005"));

    // The stops are seen wherever the page is.
    browser.ask("scrollTo(0, document.body.scrollHeight)");
    let seen = "[...document.querySelectorAll('#stops button')].filter((one) => { const box = one.getBoundingClientRect(); return box.top >= 0 && box.bottom <= innerHeight; }).length === 3";
    browser.wait(seen);
    browser.ask("document.querySelector('#stops button').click()");
    browser.wait("document.querySelector('.stopped').textContent === 'last stop: a protective stop was asked for'");
    browser.press(on, true);
    browser.wait("document.querySelector('#log .bad')?.textContent.includes('resume')");
    browser.press(on, false);
    browser.click("Resume");
    browser.ask("document.querySelector('#stops button:last-child').click()");
    browser.wait(&fact("State", "estopped"));
    browser.wait("document.querySelector('.jog').closest('section').inert");
    browser.click("Reset");
    browser.wait(&fact("State", "cold"));
    browser.resize((360, 800));
    browser.wait("document.documentElement.scrollWidth <= innerWidth");
    assert_eq!(browser.complaints, Vec::<String>::new());
}
