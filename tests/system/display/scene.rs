//! The overview: the arm in three dimensions, the pictures of the cameras, and how far the job is, all at one moment.

use rustix::process::Signal;

use super::{SIZE, boot, browser::Browser, pictures, scratch};

/// The colours of the scene's canvas, as counted by the page: how many there are, and the share of the most frequent one.
const COLOURS: &str = "(() => { const view = nets.overview.view; nets.overview.paint(); const { gl } = view; \
     const [width, height] = [gl.drawingBufferWidth, gl.drawingBufferHeight]; const pixels = new Uint8Array(4 * width * height); \
     gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels); const counts = new Map(); \
     for (let at = 0; at < pixels.length; at += 4) { const key = (pixels[at] << 16) | (pixels[at + 1] << 8) | pixels[at + 2]; counts.set(key, (counts.get(key) ?? 0) + 1); } \
     return [counts.size, Math.max(...counts.values()) / (width * height)]; })()";

/// Where the tool is drawn, m.
const TOOL: &str =
    "nets.overview.parts().find((one) => one.part.kind === 'tool').row.slice(1, 4).join()";

#[test]
#[ignore = "needs Chromium"]
fn the_overview_opens_first_and_shows_the_arm_as_it_moves_with_pictures_and_progress() {
    let scratch = scratch();
    // It stays at its last position.
    let waits = "task.dispatcher.args.breakpoints=[\"loop_done\"]";
    let truth = ["--profile", "truth", "--record", "run.mcap"];
    let (run, page) = boot(&scratch, &[&["--set", waits], &truth[..]].concat());
    let mut browser = Browser::open(&page, SIZE);
    browser.wait("nets.whole && nets.overview.view.works && nets.overview.parts().length >= 8");
    let [colours, most] = [0, 1].map(|at| browser.ask(COLOURS)[at].as_f64().unwrap());
    assert!(
        colours > 100.0 && most < 0.98,
        "a blank canvas: {colours} colours, {most} of one"
    );
    // It moves, and the table says the same in numbers.
    let before = browser.ask(TOOL);
    browser.wait(&format!("{TOOL} !== {before}"));
    browser.wait("[...document.querySelectorAll('#parts tbody th')].map((one) => one.textContent).join() === 'base,link1,link2,link3,link4,link5,link6,tool'");
    // What was found is marked on the picture, and said.
    browser.wait("document.querySelectorAll('.pictures figure .spot').length === 2");
    browser.wait("document.querySelector('.pictures figcaption').textContent.includes('spot at')");
    let beside = "(() => { const { taken, marks } = nets.overview.pictures.at('ceiling_west', null); const [u, v] = marks[0].at; return u > 0 && v > 0 && u < taken[0] && v < taken[1] && marks[0].sd[0] < 1; })()";
    browser.wait(beside);
    browser.wait("/^position [0-9]+ of [0-9]+/.test(document.querySelector('#job-words').textContent) && document.querySelector('#job-bar').value > 0");

    if let Some(picture) = std::env::var_os("CTOS_OVERVIEW") {
        let moves = "document.querySelector('#side .words').textContent === 'moves'";
        browser.wait(&format!("nets.overview.job()?.done >= 7 && {moves}"));
        browser.picture(picture.as_ref());
    }

    // A part is chosen where it is seen, or by keys; its joint is told.
    browser.ask("nets.overview.choose(null)");
    let pick = "(() => { const link = nets.overview.parts().find((one) => one.part.name === 'base'); const at = nets.overview.view.where([0, 0, 0.3]); return nets.overview.view.pick(nets.overview.parts(), at) === link.key; })()";
    assert_eq!(browser.ask(pick), true);
    browser.ask("document.querySelector('.scene canvas').focus()");
    for _ in 0..3 {
        browser.ask("document.activeElement.dispatchEvent(new KeyboardEvent('keydown', { key: 'Enter', bubbles: true }))");
    }
    browser.wait("document.querySelector('#side .chosen h2').textContent.startsWith('link2')");
    browser.wait("document.querySelector('.scene .label').textContent.includes('joint2')");
    let azimuth = browser.ask("nets.overview.view.camera.azimuth");
    browser.ask("document.activeElement.dispatchEvent(new KeyboardEvent('keydown', { key: 'ArrowLeft', bubbles: true }))");
    assert_ne!(browser.ask("nets.overview.view.camera.azimuth"), azimuth);

    // A number of it is plotted, on the time axis of the lanes; so are the tokens of a place.
    let plot = "document.querySelector('#side [aria-label=\"Plot error\"]')";
    browser.ask(&format!("{plot}.click()"));
    browser.wait(&format!("{plot}.getAttribute('aria-pressed') === 'true'"));
    let told = "document.querySelector('.plot canvas').getAttribute('aria-label')";
    browser.wait(&format!(
        "/^link2 · error: from .*° to .*°; .*° at the moment shown$/.test({told})"
    ));
    browser.wait("(() => { const [plot, lanes] = ['.plot canvas', '#lanes canvas'].map((css) => document.querySelector(css).getBoundingClientRect()); return Math.abs(plot.left - lanes.left - nets.lanes.left) < 1 && Math.abs(plot.right - lanes.right) < 1; })()");
    let tokens = "(() => { const net = nets.nets.get('dispatcher'); const place = net.view.places.findIndex((one, at) => net.history(one.name).length > 2); return [net.view.places[place].name, net.head.places[place]]; })()";
    let place = browser.ask(&format!("{tokens}[0]"));
    browser.ask(&format!(
        "nets.plots.toggle('tokens/dispatcher/' + {place})"
    ));
    browser.wait(&format!(
        "document.querySelectorAll('.plot output')[1].textContent === String({tokens}[1])"
    ));
    browser.ask("nets.zoomTime(0.1)");
    browser.wait("(() => { const [from, to] = nets.window(); const [first, last] = nets.span(); return to - from < 0.15 * (last - first) && to > last - 1e9; })()");
    pictures(&mut browser, "plots");
    let kept = browser.ask("location.hash");
    browser.ask("nets.zoomTime(100)");
    browser.ask("document.querySelectorAll('.plot button')[1].click()");
    browser.wait("document.querySelectorAll('.plot').length === 1");

    // A small number keeps its sign, and nothing has none.
    browser.ask("import('./cell.js').then(({ measure }) => { globalThis.measured = [measure(-0.001, 'rad'), measure(-1e-6, 'rad'), measure(-0.5, 'N'), measure(-0.0004, 'm')].join(); })");
    browser.wait("globalThis.measured === '−0.06°,0.00°,−0.5 N,−0.4 mm'");

    // The simulator's truth is a layer that says so, off at first.
    assert_eq!(
        browser.ask("nets.overview.parts().some((one) => one.truth)"),
        false
    );
    browser.ask("document.querySelector('.scene .truth input').click()");
    browser.wait("nets.overview.parts().some((one) => one.truth && one.part.kind === 'camera')");
    browser.wait("document.querySelector('#side').textContent.includes('simulator\\'s truth')");
    pictures(&mut browser, "overview");
    browser.ask("document.querySelector('.scene .truth input').click()");

    // One moment for all: back where the first picture was not yet taken.
    browser.ask("nets.goTo(nets.overview.tracks.get('state').steps[0].at_ns)");
    browser.wait("document.querySelectorAll('.pictures .none').length === 2");
    browser.wait(
        "document.querySelector('#status').textContent.includes('looking back') && nets.overview.job() === null",
    );
    let there = browser.ask(TOOL);
    browser.click("Live");
    browser.wait(&format!("{TOOL} !== {there}"));
    assert_eq!(browser.complaints, Vec::<String>::new());

    // The record knows the same.
    drop(browser);
    run.signal(Signal::INT);
    run.end();
    let files = ["run.ws1.mcap", "run.viewers.mcap"];
    scratch
        .ctos(&["display", files[0], files[1], "--export", "run.html"])
        .must_exit(0);
    let file = format!("file://{}", scratch.path("run.html").display());
    let mut browser = Browser::open(&file, SIZE);
    // A record opens at its beginning, when perhaps nothing was shown yet.
    browser.wait("nets.whole");
    browser.ask("nets.goTo(nets.overview.span[1])");
    browser.wait("nets.overview.parts().length >= 8");
    browser.wait("document.querySelectorAll('.pictures figure .spot').length === 2");
    browser.wait("nets.overview.job()?.done > 0");
    let last = browser.ask(TOOL);
    assert_ne!(last, there);
    browser.ask("nets.goTo(nets.overview.tracks.get('state').steps[0].at_ns)");
    browser.wait(&format!("{TOOL} === {there}"));
    assert_eq!(browser.complaints, Vec::<String>::new());

    // A link brings the plots.
    browser.go("about:blank");
    browser.go(&format!("{file}{}", kept.as_str().unwrap()));
    browser.wait("document.querySelectorAll('.plot').length === 2");
    browser.wait("/^link2 · error: from /.test(document.querySelector('.plot canvas').getAttribute('aria-label'))");
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[test]
#[ignore = "needs Chromium"]
fn the_scene_is_drawn_fifteen_times_a_second_without_a_graphics_card() {
    let scratch = scratch();
    let (_run, page) = boot(&scratch, &["--profile", "truth"]);
    let mut browser = Browser::open(&page, SIZE);
    browser.wait("nets.whole && nets.overview.parts().length >= 8");
    browser.ask("document.querySelector('.scene .truth input').click()");
    // All pixels of each drawing are waited for. Others may use the machine as well: the quickest tenth
    // says what a drawing takes.
    let time = "(() => { const view = nets.overview.view; const one = new Uint8Array(4); const took = []; const begun = performance.now(); \
         while (performance.now() - begun < 2000) { const from = performance.now(); view.turn(0.02, 0); nets.overview.paint(); view.gl.readPixels(0, 0, 1, 1, view.gl.RGBA, view.gl.UNSIGNED_BYTE, one); took.push(performance.now() - from); } \
         took.sort((a, b) => a - b); const quick = took.slice(0, Math.ceil(took.length / 10)); return (1000 * quick.length) / quick.reduce((sum, one) => sum + one, 0); })()";
    let rate = browser.ask(time).as_f64().unwrap();
    assert!(rate > 15.0, "{rate} drawings a second");
}

#[test]
#[ignore = "needs Chromium"]
fn a_browser_without_webgl_says_so_and_tells_all_in_its_table() {
    let scratch = scratch();
    let (_run, page) = boot(&scratch, &[]);
    let mut browser = Browser::open("about:blank", SIZE);
    browser.before("HTMLCanvasElement.prototype.getContext = ((own) => function (kind, ...more) { return kind === 'webgl2' ? null : own.call(this, kind, ...more); })(HTMLCanvasElement.prototype.getContext)");
    browser.go(&page);
    browser.wait("nets.whole && !nets.overview.view.works && nets.overview.parts().length >= 8");
    browser.wait("document.querySelector('.scene .missing').textContent.includes('no WebGL2')");
    browser.wait("[8, 9].includes(document.querySelectorAll('#parts tbody tr').length)");
    let row = "document.querySelectorAll('#parts tbody tr')[2].textContent";
    let before = browser.ask(row);
    browser.wait(&format!("{row} !== {before}"));
    browser.wait("document.querySelectorAll('.pictures figure .spot').length > 0");
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[test]
#[ignore = "needs Chromium"]
fn a_layout_shows_its_panes_and_plots_and_one_that_is_saved_is_there_for_the_next_browser() {
    let scratch = scratch();
    let (_run, page) = boot(&scratch, &[]);
    let mut browser = Browser::open(&page, SIZE);
    browser.wait("nets.whole && nets.overview.parts().length >= 8");
    let tab = |name: &str| {
        format!(
            "[...document.querySelectorAll('#tabs button')].find((one) => one.textContent === '{name}')"
        )
    };
    browser.ask(&format!("{}.click()", tab("following")));
    browser.wait("document.querySelectorAll('.plot').length === 4");
    browser.wait("[...document.querySelectorAll('.plot output')].every((one) => one.textContent !== 'not known')");
    let shown = "['cell', 'stage', 'side', 'lanes', 'events'].filter((one) => document.getElementById(one).offsetParent !== null).join()";
    assert_eq!(browser.ask(shown), "cell,side,lanes");
    assert_eq!(
        browser.ask("document.querySelector('.pictures').offsetParent"),
        serde_json::Value::Null
    );
    pictures(&mut browser, "layout");

    // A person wants the pictures, too, and no lanes, and keeps that under a name.
    for pane in ["pictures", "lanes"] {
        browser.ask(&format!(
            "document.querySelector('#panes [name={pane}]').click()"
        ));
    }
    browser.wait("document.querySelector('.pictures').offsetParent !== null");
    assert_eq!(browser.ask(shown), "cell,side");
    browser.ask("document.querySelector('#panes [name=layout]').value = 'mine'");
    browser.ask("document.querySelector('#panes form').requestSubmit()");
    browser.wait(&format!("{} !== undefined", tab("mine")));
    assert_eq!(browser.complaints, Vec::<String>::new());
    let file = scratch.read("configs/displays/calibrate.toml");
    assert!(
        file.starts_with("# Layouts of the page") && file.contains("[layout.mine]"),
        "{file}"
    );
    let mut other = Browser::open(&format!("{page}#layout=mine"), SIZE);
    other.wait("nets.panes.layout === 'mine' && document.querySelectorAll('.plot').length === 4");
    assert_eq!(other.ask(shown), "cell,side");
    // The built-in ones are as ever.
    other.ask(&format!("{}.click()", tab("motion")));
    other.wait(&format!("{shown} === 'stage,side,lanes,events'"));
    assert_eq!(other.complaints, Vec::<String>::new());
}
