//! How the app stands as a whole: its chassis, and the last warnings.

use rustix::process::Signal;

use super::*;

#[test]
#[ignore = "needs Chromium"]
fn the_overview_shows_how_each_chassis_is_and_the_last_warnings_also_from_the_record() {
    let scratch = scratch();
    // Without a chassis the arm is stopped, and the calibration fails: it waits before its first firing.
    let waits = "task.dispatcher.args.breakpoints=[\"init_calib\"]";
    let (mut run, page) = boot(&scratch, &["--record", "run.mcap", "--set", waits]);
    let mut browser = Browser::open(&page, SIZE);
    let chips = "[...document.querySelectorAll('#side .chassis li')].map((one) => one.textContent)";
    browser.wait(&format!("{chips}.length === 6"));
    browser.wait(&format!(
        "{chips}.every((text) => text.endsWith('up')) && {chips}.some((text) => text.startsWith('cage_motion'))"
    ));
    let warned = "[...document.querySelectorAll('#side .warnings li')].some((one) => one.textContent.includes('isle'))";
    browser.ask("nets.nets.get('dispatcher').known = 7");

    run.kill("isle");
    run.wait_for("is up again");
    browser.wait(&format!(
        "{chips}.some((text) => text.startsWith('isle') && text.includes('started again once'))"
    ));
    browser.wait(warned);
    browser.wait(&format!(
        "{chips}.every((text) => text.includes('up')) && nets.nets.get('isle').gone === null"
    ));
    // The other nets are not told anew.
    assert_eq!(browser.ask("nets.nets.get('dispatcher').known"), 7);
    pictures(&mut browser, "standing");
    // A warning leads to its moment, and before it there is none.
    browser.ask("document.querySelector('#side .warnings button').click()");
    browser.wait("nets.cursor !== null");
    browser.ask("nets.goTo(nets.span()[0])");
    browser.wait(&format!("!{warned}"));
    assert_eq!(browser.complaints, Vec::<String>::new());

    drop(browser);
    run.signal(Signal::INT);
    run.end();
    let export = [
        "display",
        "run.boot.mcap",
        "run.ws1.mcap",
        "run.viewers.mcap",
        "--export",
        "run.html",
    ];
    scratch.ctos(&export).must_exit(0);
    let file = format!("file://{}", scratch.path("run.html").display());
    let mut browser = Browser::open(&file, SIZE);
    browser.wait("nets.standing.warnings.some((one) => one.text.includes('isle'))");
    browser.ask("nets.goTo(nets.span()[1])");
    browser.wait(warned);
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[test]
#[ignore = "needs Chromium"]
fn what_waits_for_a_task_and_how_long_actions_take_can_be_plotted() {
    let scratch = scratch();
    let (_run, page) = boot(&scratch, &[]);
    let mut browser = Browser::open(&page, SIZE);
    browser.wait("nets.loads.moments.length > 3");
    browser.ask("nets.lookAt('mcs')");
    let link = "[...document.querySelectorAll('#side button.link')].find((one) => one.textContent === 'messages handled a second')";
    browser.wait(link);
    browser.ask(&format!("{link}.click()"));
    browser.ask("nets.plots.toggle('task/mcs/queue')");
    browser.ask("nets.plots.toggle('duration/dispatcher/move_robot')");
    // Motions take between a tenth of a second and ten.
    browser.wait("nets.plots.dataOf(nets.plots.rows.get('duration/dispatcher/move_robot')).points.filter(([, time]) => time > 0.05 && time < 60).length > 2");
    browser.wait("nets.plots.dataOf(nets.plots.rows.get('task/mcs/rate')).points.some(([, rate]) => rate > 0)");
    browser.wait("[...document.querySelectorAll('.plot output')].every((one) => one.textContent !== 'not known')");
    pictures(&mut browser, "plots");
    assert_eq!(browser.complaints, Vec::<String>::new());
}
