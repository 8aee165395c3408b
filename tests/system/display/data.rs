//! Declared data of a net: beside its place, in the side, in the table of events, and over time.

use super::{SIZE, boot_app, browser::Browser, pictures};
use crate::harness::Scratch;

#[test]
#[ignore = "needs Chromium"]
fn values_stand_beside_the_place_that_they_are_stored_with_and_their_changes_in_table_and_lanes() {
    let scratch = Scratch::new();
    // The page sees a past only from when it attached: the net waits before its first firing. Then it waits with what
    // it was answered, before it thanks.
    let waits = [
        "--set",
        "task.greet.args.breakpoints=[\"begin\", \"thank\"]",
    ];
    let (_run, page) = boot_app(&scratch, "configs/greet.toml", &waits);
    let mut browser = Browser::open(&format!("{page}#net=greet"), SIZE);
    browser.wait("nets.nets.get('greet')?.head.paused?.includes('begin')");
    browser.click("Release net");
    browser.wait("nets.nets.get('greet').head.paused?.includes('thank')");
    let beside = "[...document.querySelectorAll('.names .name')].filter((name) => name.firstChild.textContent === 'served').flatMap((name) => [...name.querySelectorAll('.value')]).map((line) => line.textContent).join('; ')";
    browser.wait(&format!("{beside} === 'tea = 0.2; lemon = 0.5'"));
    // What belongs to no place stands in the side.
    browser.wait("/count3/.test(document.querySelector('#side [aria-label=data]').textContent.replaceAll(' ', ''))");
    browser.wait("[...document.querySelectorAll('#events tbody td:last-child')].some((cell) => cell.textContent === 'cup.tea = 0.2, cup.lemon = 0.5')");
    browser.wait("nets.lanes.rows.some((row) => row.name === 'count' && row.spans.map((span) => span.text).join() === '0,1,2,3')");
    pictures(&mut browser, "data");
    // An earlier moment has the values of then.
    browser.ask("(() => { const scrub = document.querySelector('#scrub'); scrub.value = 0; scrub.dispatchEvent(new Event('input')); })()");
    browser.wait(&format!("{beside} === 'tea = 0.0; lemon = 0.0'"));
    assert_eq!(browser.complaints, Vec::<String>::new());
}
