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
    let free = "[...document.querySelectorAll('main button, main input, main select')].filter((one) => !one.disabled).length";
    assert_eq!(browser.ask(free), 0);
    assert_eq!(
        browser.ask("document.querySelector('#line')"),
        serde_json::Value::Null
    );
    // Whoever asks all the same is refused.
    let refused = "fetch('ask', { method: 'POST', body: 'mvpos CTRL -speed 0.125' }).then((reply) => reply.ok)";
    assert_eq!(browser.ask(refused), false);
    // On a narrow screen nothing has to be pushed sideways.
    browser.resize((360, 800));
    browser.wait("document.documentElement.scrollWidth <= innerWidth");
}
