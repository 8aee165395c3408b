//! What of the scene may be left out: forces, guards, margins, contacts; and the net that stays in view.

use super::{SIZE, boot, boot_app, browser::Browser, pictures, scratch};
use crate::harness::Scratch;

/// The kinds of parts that are drawn.
const KINDS: &str = "[...new Set(nets.overview.parts().map((one) => one.part.kind))].sort().join()";

/// How many pixels of the scene have another colour than those of a second drawing, without `layer`.
fn pixels_of(layer: &str) -> String {
    format!(
        "(() => {{ const {{ view }} = nets.overview; const {{ gl }} = view; const read = () => {{ nets.overview.paint(nets.overview.parts(), 1); const all = new Uint8Array(4 * gl.drawingBufferWidth * gl.drawingBufferHeight); \
         gl.readPixels(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight, gl.RGBA, gl.UNSIGNED_BYTE, all); return all; }}; \
         const box = document.querySelector('[data-layer={layer}] input'); const one = read(); box.click(); const other = read(); box.click(); \
         return one.reduce((sum, value, at) => sum + (at % 4 === 0 && value !== other[at] ? 1 : 0), 0); }})()"
    )
}

#[test]
#[ignore = "needs Chromium"]
fn the_arms_of_the_testbed_stand_apart_with_their_margins_and_what_is_nearest() {
    let scratch = Scratch::new();
    let (_run, page) = boot_app(&scratch, "configs/testbed-collision.toml", &[]);
    let mut browser = Browser::open(&page, SIZE);
    browser.wait("nets.whole && nets.overview.parts().length >= 24");
    // There is no net, so the scene has its room.
    browser.wait("document.getElementById('stage').hidden && document.querySelector('#why').textContent === 'this app has no nets'");
    let base = |side: &str| {
        format!(
            "nets.overview.parts().find((one) => one.track.source === 'state_{side}' && one.part.kind === 'base').row.slice(1, 4).join()"
        )
    };
    assert_eq!(browser.ask(&base("left")), "0,0,0");
    assert_eq!(browser.ask(&base("right")), "0,1.2,0");
    assert_eq!(browser.ask(KINDS), "base,guard,link,tool");
    // What is nearest is known from the first motion on.
    let moved = [
        "testbed",
        "-c",
        "mvpos.left EXEC by FMSG 9 0.1 0 0 0 0.9 0 0 0 0",
    ];
    scratch.scott(&moved).must_exit_leaving(0);
    assert_eq!(
        browser.ask("document.querySelector('.scene .distance').hidden"),
        true
    );
    browser.ask("document.querySelector('[data-layer=margins] input').click()");
    browser.wait(&format!(
        "{KINDS} === 'base,guard,link,margin,nearest,tool'"
    ));
    browser.wait("/^[0-9.]+ mm$/.test(document.querySelector('.scene .distance').textContent)");
    browser.wait("/ is near /.test(document.querySelector('#side .words').textContent)");
    let drawn = browser.ask(&pixels_of("margins")).as_f64().unwrap();
    assert!(drawn > 300.0, "{drawn} px of margins");
    pictures(&mut browser, "margins");
    browser.ask("document.querySelector('[data-layer=guards] input').click()");
    browser.wait(&format!("{KINDS} === 'base,link,margin,nearest,tool'"));
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[test]
#[ignore = "needs Chromium"]
fn forces_that_a_wrist_feels_and_contacts_of_the_simulator_are_drawn_as_arrows() {
    let scratch = Scratch::new();
    let truth =
        "[task.truth]\nhandler = \"sim.truth\"\non = \"cage/main\"\nargs.world = \"world\"\n";
    let config = scratch.read("configs/push.toml");
    scratch.write("configs/push.toml", config + "\n" + truth);
    let (_run, page) = boot_app(&scratch, "configs/push.toml", &[]);
    let mut browser = Browser::open(&page, SIZE);
    browser.wait("nets.whole && nets.overview.parts().some((one) => one.part.kind === 'force')");
    browser.ask("document.querySelector('.scene .truth input').click()");
    // The box, which no robot knows, and what touches the arm.
    browser.wait("nets.overview.parts().some((one) => one.part.kind === 'object')");
    let arrow = |kind: &str| {
        format!(
            "nets.overview.parts().filter((one) => one.part.kind === '{kind}').map((one) => Math.hypot(...one.row.slice(8, 11))).some((force) => force > 2)"
        )
    };
    // The page stops at such a moment, near the wrist.
    browser.wait(&format!(
        "(() => {{ const both = {} && {}; if (both && nets.cursor === null) nets.goTo(nets.now()); return both; }})()",
        arrow("force"),
        arrow("contact")
    ));
    browser.ask("nets.overview.choose('state_arm/wrist')");
    browser.ask("(() => { const { view } = nets.overview; view.followed = 'state_arm/wrist'; view.dolly(0.45); nets.overview.choose(null); })()");
    let drawn = browser.ask(&pixels_of("forces")).as_f64().unwrap();
    pictures(&mut browser, "forces");
    assert!(drawn > 20.0, "{drawn} px of an arrow");
    // A number of it can be plotted as any other.
    browser.ask("nets.plots.toggle('number/state_arm/wrist/force%20x')");
    browser.wait("document.querySelectorAll('.plot output').length === 1");
    assert_eq!(browser.complaints, Vec::<String>::new());
}

/// The smallest letter of a name that the net shows, px, and whether every running transition is seen.
const LEGIBLE: &str = "12 * nets.picture.scale";
const SEEN: &str = "[...nets.picture.nodes.values()].filter((one) => one.state === 'running').some(({ node }) => node.x > nets.picture.box.x && node.y > nets.picture.box.y && node.x < nets.picture.box.x + nets.picture.box.width && node.y < nets.picture.box.y + nets.picture.box.height)";

#[test]
#[ignore = "needs Chromium"]
fn a_wide_net_beside_the_scene_is_read_at_what_is_under_way_until_somebody_looks_elsewhere() {
    let scratch = Scratch::new();
    let (_run, page) = boot_app(&scratch, "configs/carry.toml", &[]);
    let mut browser = Browser::open(&page, SIZE);
    browser.wait("nets.whole && nets.shown === 'dispatcher' && nets.active");
    // A stream that begins anew while the app boots tells its nets again.
    browser.wait("nets.nets.has('dispatcher')");
    for _ in 0..2 {
        let before = browser.ask("nets.nets.get('dispatcher')?.head.seq ?? 0");
        browser.wait(&format!(
            "nets.nets.get('dispatcher')?.head.seq > {before} && {SEEN} && !nets.picture.glide && {LEGIBLE} >= 7"
        ));
    }
    pictures(&mut browser, "wide-net");
    // As a whole its names could not be read: that is why.
    browser.click("Fit");
    browser.wait("!nets.active");
    let letters = browser.ask(LEGIBLE).as_f64().unwrap();
    assert!(letters < 7.0, "letters of {letters} px");
    browser.click("Active");
    browser.wait(&format!("nets.active && {LEGIBLE} >= 7"));
    // Who pans or zooms looks where they want.
    let wheel = "(() => { const svg = document.querySelector('svg.net'); const box = svg.getBoundingClientRect(); svg.dispatchEvent(new WheelEvent('wheel', { deltaY: -120, clientX: box.x + 20, clientY: box.y + 20, bubbles: true, cancelable: true })); })()";
    browser.ask(wheel);
    browser.wait("!nets.active");
    let kept = browser.ask("JSON.stringify(nets.picture.box)");
    let before = browser.ask("nets.nets.get('dispatcher')?.head.seq ?? 0");
    browser.wait(&format!(
        "nets.nets.get('dispatcher')?.head.seq > {before} || nets.mode === 'ended'"
    ));
    assert_eq!(browser.ask("JSON.stringify(nets.picture.box)"), kept);
    // More room for the net, by keys.
    let tall = "document.getElementById('stage').clientHeight";
    let small = browser.ask(tall).as_f64().unwrap();
    browser.ask("document.getElementById('share').focus()");
    for _ in 0..4 {
        browser.ask("document.activeElement.dispatchEvent(new KeyboardEvent('keydown', { key: 'ArrowUp', bubbles: true }))");
    }
    browser.wait(&format!("{tall} > {small} + 90"));
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[test]
#[ignore = "needs Chromium"]
fn an_app_that_draws_nothing_leaves_all_of_the_overview_to_the_net_of_its_task() {
    let scratch = Scratch::new();
    // Without its operator it does not end.
    let text = scratch.read("configs/greet.toml");
    let (app, _) = text.split_once("# Puts one command").unwrap();
    scratch.write(
        "configs/greet.toml",
        app.replace("until = \"operator\"", ""),
    );
    let (_run, page) = boot_app(&scratch, "configs/greet.toml", &[]);
    let mut browser = Browser::open(&page, SIZE);
    browser.wait("nets.shown === 'greet' && nets.picture.nodes.size > 3");
    browser.wait("document.getElementById('cell').hidden && document.getElementById('stage').clientHeight > 500");
    browser.wait(&format!("{LEGIBLE} >= 7"));
    pictures(&mut browser, "greet");
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[test]
#[ignore = "needs Chromium"]
fn the_calibration_keeps_its_net_readable_beside_the_scene() {
    let scratch = scratch();
    let (_run, page) = boot(&scratch, &[]);
    let mut browser = Browser::open(&page, SIZE);
    browser.wait("nets.whole && nets.shown === 'dispatcher' && nets.overview.parts().length >= 8");
    browser.wait(&format!("{LEGIBLE} >= 7 && {SEEN}"));
    pictures(&mut browser, "calibration");
    assert_eq!(browser.complaints, Vec::<String>::new());
}
