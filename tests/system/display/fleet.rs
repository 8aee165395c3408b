//! A fleet in virtual time on one page: a person sees all cells, goes down to the net of one, and back.

use super::{SIZE, boot_app, browser::Browser, pictures};
use crate::harness::Scratch;

/// The number of a fact.
fn fact(name: &str) -> String {
    format!(
        "Number(document.querySelector('#summary > section > .facts [data-fact=\"{name}\"] dd')?.textContent)"
    )
}

#[test]
#[ignore = "needs Chromium"]
fn a_hundred_cells_stand_on_one_page_and_clicks_lead_to_the_net_of_one_and_back() {
    let scratch = Scratch::new();
    let name = format!("app.name=\"fleet_page_{}\"", std::process::id());
    let sets = ["fleet.cells=100", "fleet.sites=4", &name];
    let sets = sets.iter().flat_map(|set| ["--set", set]);
    let more: Vec<&str> = sets.chain(["--profile", "gentle-hand", "--json"]).collect();
    let (_run, page) = boot_app(&scratch, "configs/fleet.toml", &more);
    let mut browser = Browser::open(&page, SIZE);

    // All cells are there, each in the area of its site, and the counts are those of the marks.
    browser.wait("document.querySelectorAll('#summary .item').length === 100");
    browser.wait("document.querySelectorAll('#summary article').length === 4");
    browser.wait(&format!("{} === 100", fact("cells")));
    browser.wait(&format!("{} > 20", fact("carried")));
    let states = "[...document.querySelectorAll('#summary .states b')].reduce((sum, one) => sum + Number(one.textContent), 0)";
    browser.wait(&format!("{states} === 100"));
    browser.wait("document.querySelectorAll('#summary .item.new').length >= 2");
    browser.wait("/attempts succeeded; test [+-]/.test(document.querySelector('[data-fact=\"version 2\"]').textContent)");
    pictures(&mut browser, "fleet");

    // A click on a site shows its cells with names, a click on one of them its net.
    browser.click("site3");
    let shown =
        "[...document.querySelectorAll('#summary .item')].filter((one) => one.checkVisibility())";
    browser.wait(&format!("{shown}.length === 25"));
    browser.wait(&format!(
        "{shown}[3].innerText.includes('cell54') && /idle|working/.test({shown}[3].innerText)"
    ));
    pictures(&mut browser, "fleet-site");
    browser.ask("document.querySelector('[data-item=\"cell54\"]').click()");
    browser.wait("nets.shown === 'cell54.dispatcher' && nets.panes.shown.has('net')");
    let fired = "nets.nets.get('cell54.dispatcher').head.ended.reduce((a, b) => a + b)";
    let before = browser.ask(fired);
    browser.wait(&format!("{fired} > {before}"));
    assert_eq!(browser.ask("nets.nets.size"), 1, "no other net is followed");
    pictures(&mut browser, "fleet-net");

    // Back to all.
    browser.click("summary");
    browser.click("← all groups");
    browser.wait(&format!("{shown}.length === 100"));
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[test]
#[ignore = "needs Chromium"]
fn who_looks_on_until_the_end_of_a_fleet_has_seen_the_counts_of_the_referee() {
    let scratch = Scratch::new();
    let name = format!("app.name=\"fleet_end_{}\"", std::process::id());
    // While a rollout is under way jobs are issued: that takes minutes, no faster than the clock. This takes one.
    let few = "task.company.args.jobs_per_cell=1";
    let sets = ["fleet.cells=30", few, &name];
    let sets = sets.iter().flat_map(|set| ["--set", set]);
    let more: Vec<&str> = sets.chain(["--json"]).collect();
    let (run, page) = boot_app(&scratch, "configs/fleet.toml", &more);
    let mut browser = Browser::open(&page, SIZE);
    browser.wait(&format!("{} > 20", fact("carried")));
    browser.wait("nets.mode === 'ended'");
    let counted = ["jobs issued", "carried", "not carried", "open"];
    let counted = counted.map(|name| browser.ask(&fact(name)));
    assert_eq!(browser.complaints, Vec::<String>::new());
    let ended = run.end();
    ended.must_exit(0);
    let result = ended.json();
    let referee = ["jobs", "carried", "not_carried"].map(|key| result[key].clone());
    assert_eq!(counted[..3], referee);
    assert_eq!(counted[3], 0);
    assert_eq!(result["lost"], serde_json::json!([]));
}
