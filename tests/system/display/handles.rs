//! What a person takes hold of on the page of the tracker: the ball, the arm's hand, the 3-D mouse.

use super::{SIZE, boot_app, browser::Browser, pictures};
use crate::harness::Scratch;

/// A ball that rests, for as long as somebody looks, and fewer pictures: a browser runs beside it.
const RESTS: [&str; 6] = [
    "--set",
    "task.ball.args.motion=\"rest\"",
    "--set",
    "task.tracker.args.seconds=0.0",
    "--set",
    "task.argus.args.period_ms=80.0",
];

/// Where a part of the scene is, m.
fn part(key: &str) -> String {
    format!("nets.overview.parts().find((one) => one.key === '{key}').row.slice(1, 4)")
}

/// How far apart two places are, m.
const APART: &str = "((a, b) => Math.hypot(...[0, 1, 2].map((axis) => a[axis] - b[axis])))";

#[test]
#[ignore = "needs Chromium"]
fn a_person_drags_the_ball_pulls_the_hand_and_steers_the_mouse_from_the_page_and_the_arm_follows() {
    let scratch = Scratch::new();
    let name = format!("app.name=\"tracker_page_{}\"", std::process::id());
    // The usual file of displays has the name of the app.
    let displays = "task.display.args.displays=\"displays/tracker.toml\"";
    let sets = [&RESTS[..], &["--set", &name, "--set", displays]].concat();
    let (_run, page) = boot_app(&scratch, "configs/tracker.toml", &sets);
    let mut browser = Browser::open(&page, SIZE);
    let seen = "document.querySelector('.handle.way:not([hidden])') && document.querySelector('.handle.force:not([hidden])') && document.querySelector('.pad:not([hidden])')";
    browser.wait(&format!("nets.whole && {seen}"));
    let track = "(() => { const net = nets.nets.get('tracking'); return net.head.places[net.index.places.get('track')] === 1; })()";
    browser.wait(track);

    // Nearer, so that a person sees what is done.
    browser.ask("(() => { const { view } = nets.overview; view.camera.target = [0.6, -0.1, 0.5]; view.dolly(0.6); })()");
    let (ball, hand) = (part("truth/ball"), part("state_arm/link6"));
    // As it has learned to stand over the ball. A browser beside the app costs it some mm.
    let over =
        format!("{APART}({hand}, [0.05, 0, 0.44].map((by, axis) => by + {ball}[axis])) < 0.015");
    browser.wait(&over);
    let before = browser.ask(&ball);
    let way = browser.ask("nets.overview.view.along([0.65, -0.145, 0.27], 30, -5)");
    let at = browser.pull(".handle.way", (30.0, -5.0));
    browser.wait("document.querySelector('path.pull.way').getAttribute('d') !== ''");
    pictures(&mut browser, "tracker-ball");
    browser.let_go(at);
    // The ball is where it was dragged, and the hand stands over it as before.
    browser.wait(&format!(
        "{APART}({ball}, [0, 1, 2].map((axis) => {before}[axis] + {way}[axis])) < 0.004"
    ));
    browser.wait(&over);

    // A force as long as it is held, which the wrist feels, and the hand gives way.
    let rests = browser.ask(&hand);
    let felt = "Math.hypot(...nets.overview.parts().find((one) => one.part.kind === 'force').row.slice(8, 11))";
    let at = browser.pull(".handle.force", (-36.0, 10.0));
    browser.wait(&format!("{felt} > 6 && {APART}({hand}, {rests}) > 0.02"));
    pictures(&mut browser, "tracker-hand");
    assert_eq!(
        browser
            .ask("/^[0-9.]+ N$/.test(document.querySelector('.pulled:not([hidden])').textContent)"),
        true
    );
    browser.let_go(at);
    browser.wait(&format!("{felt} < 2 && {over}"));

    // A deflection leads it away, and the ball gets it back.
    let at = browser.pull(".pad .across", (-30.0, 0.0));
    browser.wait(&format!("{APART}({hand}, {rests}) > 0.03"));
    pictures(&mut browser, "tracker-mouse");
    browser.let_go(at);
    browser.wait(&over);
    browser.ask("document.querySelector('.pad .lift').dispatchEvent(new KeyboardEvent('keydown', { key: 'PageUp', bubbles: true }))");
    browser.wait(&format!("{hand}[2] > {rests}[2] + 0.02"));
    browser.ask("document.querySelector('.pad .lift').dispatchEvent(new KeyboardEvent('keyup', { key: 'PageUp', bubbles: true }))");
    browser.wait(&over);
    // Too far is said.
    browser.ask("(() => { const ball = nets.overview.handles.all.find((one) => one.name === 'ball'); ball.set([3, 0, 0]); })()");
    browser.wait("/^not_dragged.*1 m/.test(document.querySelector('#banner').textContent)");
    // What was is looked at: nothing is to be taken hold of there.
    browser.ask("nets.goTo(nets.now() - 1e9)");
    browser.wait(&format!("!({seen})"));
    browser.ask("nets.live()");
    browser.wait(seen);
    assert_eq!(browser.complaints, Vec::<String>::new());

    // Who has no token sees the ball, and takes hold of nothing.
    let (bare, _) = page.split_once('?').unwrap();
    let mut browser = Browser::open(bare, SIZE);
    browser.wait("nets.whole && nets.overview.parts().some((one) => one.key === 'truth/ball')");
    browser.wait("nets.nets.has('person')");
    browser.wait("[...document.querySelectorAll('.handle, .pad')].every((one) => one.hidden)");
    browser.ask(
        "nets.put('person', ['drag', '0.1', '0', '0'], (text) => { globalThis.told = text; })",
    );
    browser.wait("/token/.test(globalThis.told)");
}
