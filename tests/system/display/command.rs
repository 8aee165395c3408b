//! Commands that a person puts on the tape of a net from the page.

use super::{SIZE, boot_app, browser::Browser, pictures};
use crate::harness::Scratch;

const FORM: &str = "document.querySelector('#side form.command')";

/// What the page says of the last command.
const SAID: &str =
    "[...document.querySelectorAll('#side .answers li')][0]?.lastChild.textContent ?? ''";

/// Types a command as a person does, and puts it on the tape.
fn put(browser: &mut Browser, line: &str) {
    browser.wait(FORM);
    browser.ask(&format!(
        "(() => {{ const line = {FORM}.querySelector('input'); line.focus(); line.value = {line:?}; line.dispatchEvent(new Event('input', {{ bubbles: true }})); }})()"
    ));
    // What goes on meanwhile takes nothing away.
    browser.ask("nets.panels()");
    browser.ask(&format!("{FORM}.requestSubmit()"));
    browser.wait(&format!(
        "[...document.querySelectorAll('#side .answers li')][0]?.firstChild.textContent === {line:?}"
    ));
}

#[test]
#[ignore = "needs Chromium"]
fn a_disc_is_carried_from_the_page_which_shows_every_answer_and_takes_no_command_without_its_token()
{
    let scratch = Scratch::new();
    let waiting = ["--profile", "waiting"];
    let (_run, page) = boot_app(&scratch, "configs/carry.toml", &waiting);
    let mut browser = Browser::open(&page, SIZE);
    browser.wait("nets.whole && nets.nets.has('dispatcher')");
    put(&mut browser, "carry 3,4 4,5");
    // Beside the scene; meanwhile the net is looked at, which has the same form.
    browser.wait(&format!("{SAID} === 'not answered yet'"));
    browser.ask("nets.open('dispatcher', null)");
    let tape = "nets.nets.get('dispatcher').head.in_progress === 'carry'";
    browser.wait(tape);
    pictures(&mut browser, "command-under-way");
    // What else is asked is answered before.
    put(&mut browser, "dance");
    browser.wait(&format!("/dance.*carry, put_back/.test({SAID})"));
    let first = "[...document.querySelectorAll('#side .answers li')].at(-1).lastChild.textContent";
    assert_eq!(browser.ask(first), "not answered yet");
    browser.wait(&format!("/^carried: /.test({first})"));
    // Nothing lies there any more.
    put(&mut browser, "carry 3,4 4,5");
    browser.wait(&format!("/^nothing_at_from: /.test({SAID})"));
    pictures(&mut browser, "command");
    assert_eq!(browser.complaints, Vec::<String>::new());

    // Who has no token sees the tape, and puts nothing there.
    let (bare, _) = page.split_once('?').unwrap();
    let mut browser = Browser::open(&format!("{bare}#net=dispatcher"), SIZE);
    browser.wait("nets.nets.has('dispatcher') && /tape empty/.test(document.querySelector('#side').textContent)");
    assert_eq!(browser.ask(FORM), serde_json::Value::Null);
    browser.ask("nets.ask('command', { net: 'dispatcher', words: ['put_back'] })");
    browser.wait("/token/.test(document.querySelector('#banner').textContent)");
}
