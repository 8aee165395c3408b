//! A person who plays checkers from the page: drags a disc on the simulated table, and the robot answers.

use super::{SIZE, boot_app, browser::Browser, pictures};
use crate::harness::Scratch;

/// Nothing goes wrong but what the person does, and White is the person.
const SETS: [&str; 16] = [
    "--set",
    "task.player.args.opponent=\"person\"",
    "--set",
    "task.player.args.colour=\"black\"",
    "--set",
    "task.player.args.nodes=2000",
    "--set",
    "task.room.args.slips=0.0",
    "--set",
    "task.room.args.bumps=0.0",
    "--set",
    "task.room.args.glare=0.0",
    "--set",
    "task.room.args.power=0.0",
    "--set",
    "task.display.args.displays=\"displays/checkers.toml\"",
];

/// What people have heard last.
const HEARD: &str = "nets.overview.tracks.get('room').head.said.words";

/// Where parts are in the board's frame, m: `[name, x, y]`.
const ON_BOARD: &str = "(() => { \
    const parts = nets.overview.parts(); \
    const board = parts.find((one) => one.key === 'room/board').row; \
    const yaw = 2 * Math.atan2(board[6], board[7]); \
    return parts.filter((one) => one.part.kind === 'disc').map((one) => { \
        const [x, y] = [one.row[1] - board[1], one.row[2] - board[2]]; \
        return [one.part.name, Math.cos(yaw) * x + Math.sin(yaw) * y, Math.cos(yaw) * y - Math.sin(yaw) * x]; \
    }); })()";

/// Whether the player has seen the board as it shall be, and waits for the person's move.
const WAITS: &str = "(() => { \
    const net = nets.nets.get('player'); \
    const waiting = net.view.places.findIndex((place) => place.name === 'waiting'); \
    return nets.stateOf(net).places[waiting] > 0; })()";

/// What the symbolic board says.
const BELIEVED: &str = "document.querySelector('[data-plan=board] .words').textContent";

/// Sets a slider or a box of the page as a person does.
fn set(browser: &mut Browser, handle: &str, value: &str) {
    browser.ask(&format!(
        "(() => {{ const input = document.querySelector('input[data-handle={handle}]'); \
         if (input.type === 'checkbox') input.checked = {value} > 0; else input.value = '{value}'; \
         input.dispatchEvent(new Event('input')); input.dispatchEvent(new Event('change')); }})()"
    ));
}

/// Whether the player has a setting in force, as its part of the scene tells.
fn in_force(name: &str, value: &str) -> String {
    format!("nets.overview.handles.numberOf('symbols/settings/{name}') === {value}")
}

/// The way on the page, px, that leads a part so far along the axes of the board.
fn way(disc: &str, along: [f64; 2]) -> String {
    let [x, y] = along;
    format!(
        "(() => {{ const {{ view }} = nets.overview; const parts = nets.overview.parts(); \
         const board = parts.find((one) => one.key === 'room/board').row; \
         const yaw = 2 * Math.atan2(board[6], board[7]); \
         const at = parts.find((one) => one.key === 'room/{disc}').row.slice(1, 4); \
         const to = [at[0] + Math.cos(yaw) * {x} - Math.sin(yaw) * {y}, at[1] + Math.sin(yaw) * {x} + Math.cos(yaw) * {y}, at[2]]; \
         const [from, there] = [view.where(at), view.where(to)]; return [there[0] - from[0], there[1] - from[1]]; }})()"
    )
}

/// Whether a disc of a colour stands there, m in the board's frame.
fn stands(colour: &str, [x, y]: [f64; 2]) -> String {
    format!(
        "{ON_BOARD}.some(([name, x, y]) => name.startsWith('{colour}') && Math.hypot(x - {x}, y - {y}) < 0.01)"
    )
}

#[test]
#[ignore = "needs Chromium"]
fn a_person_drags_a_disc_on_the_page_and_the_robot_answers_and_explains_a_move_that_is_not_legal() {
    let scratch = Scratch::new();
    let name = format!("app.name=\"checkers_page_{}\"", std::process::id());
    let sets = [&SETS[..], &["--set", &name]].concat();
    let (_run, page) = boot_app(&scratch, "configs/checkers.toml", &sets);
    let mut browser = Browser::open(&page, SIZE);
    browser.wait(&format!("nets.whole && /your turn/.test({HEARD})"));
    // From above, as one who sits at the table.
    browser.ask("(() => { const { view } = nets.overview; Object.assign(view.camera, { target: [0.5, 0, 0.42], distance: 1.0, height: 1.2 }); view.stale = true; })()");

    // 22-18: c3 to d4.
    let (c3, d4) = ([-0.09, -0.09], [-0.03, -0.03]);
    let disc = format!(
        "{ON_BOARD}.find(([name, x, y]) => name.startsWith('light') && Math.hypot(x + 0.09, y + 0.09) < 0.01)[0]"
    );
    let disc = browser.ask(&disc);
    let disc = disc.as_str().unwrap().to_owned();
    let handle = format!("[data-handle=\"light {disc}\"]");
    browser.wait(&format!(
        "document.querySelector({handle:?}) && !document.querySelector({handle:?}).hidden"
    ));
    let far = browser.ask(&way(&disc, [d4[0] - c3[0], d4[1] - c3[1]]));
    let far = (far[0].as_f64().unwrap(), far[1].as_f64().unwrap());
    browser.drag(&handle, far);
    browser.wait(&stands("light", d4));
    let first =
        "[5, 6, 7].flatMap((row) => [0, 1, 2, 3].map((column) => [2 * column + (row % 2), row]))";
    // Black's discs do not stand where they did: the robot has answered, and it is the person's turn.
    let moved = format!(
        "!{first}.every(([file, row]) => {ON_BOARD}.some(([name, x, y]) => name.startsWith('dark') && Math.hypot(x - (file - 3.5) * 0.06, y - (row - 3.5) * 0.06) < 0.015))"
    );
    browser.wait(&format!("{moved} && {WAITS} && /your turn/.test({HEARD})"));
    pictures(&mut browser, "checkers-answer");

    // No man goes backwards.
    let far = browser.ask(&way(&disc, [c3[0] - d4[0], c3[1] - d4[1]]));
    let far = (far[0].as_f64().unwrap(), far[1].as_f64().unwrap());
    browser.drag(&handle, far);
    browser.wait(&format!("/not accepted: /.test({HEARD})"));
    pictures(&mut browser, "checkers-refused");
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[test]
#[ignore = "needs Chromium"]
fn depth_and_verbosity_are_set_on_the_page_a_new_game_begins_and_the_symbolic_board_follows() {
    let scratch = Scratch::new();
    let name = format!("app.name=\"checkers_wishes_{}\"", std::process::id());
    let own = [
        "--set",
        "task.player.args.opponent=\"self\"",
        "--set",
        &name,
    ];
    let (_run, page) = boot_app(
        &scratch,
        "configs/checkers.toml",
        &[&SETS[..], &own].concat(),
    );
    let mut browser = Browser::open(&page, SIZE);
    browser.wait(&format!("nets.whole && /last move/.test({BELIEVED})"));
    // Nothing is set yet: the page shows what is configured.
    browser.wait(&in_force("verbosity", "2"));
    // What is chosen stands while the player has not taken it up.
    browser.ask(
        "(() => { const output = document.querySelector('label:has([data-handle=depth]) output'); window.depths = []; \
         new MutationObserver(() => window.depths.push(output.textContent)).observe(output, { childList: true }); })()",
    );
    set(&mut browser, "depth", "3");
    set(&mut browser, "verbosity", "3");
    browser.wait(&format!(
        "{} && {}",
        in_force("depth", "3"),
        in_force("verbosity", "3")
    ));
    let said =
        "[...document.querySelectorAll('.heard li')].map((one) => one.textContent).join('\\n')";
    browser.wait(&format!("/I move \\d+[-x]\\d+/.test({said})"));
    // The page shows what is in force, whoever has set it.
    browser.wait("document.querySelector('input[data-handle=depth]').value === '3'");
    let depths = browser.ask("window.depths.filter((shown) => shown !== '3')");
    assert_eq!(depths, serde_json::json!([]));
    pictures(&mut browser, "checkers-wishes");

    browser.ask("document.querySelector('button[data-handle=new_game]').click()");
    browser.wait(&format!(
        "/a new game/.test({said}) && !/last move/.test({BELIEVED})"
    ));
    let pieces = "[...document.querySelectorAll('[data-plan=board] .square')].length === 32";
    assert_eq!(browser.ask(pieces), true);
    // The settings are kept, and the new game goes on.
    browser.wait(&format!(
        "/last move/.test({BELIEVED}) && {}",
        in_force("depth", "3")
    ));

    // A page without the token looks on only.
    let plain = page.split(['?', '#']).next().unwrap().to_owned();
    let mut looks_on = Browser::open(&plain, SIZE);
    looks_on.wait(&format!("nets.whole && {BELIEVED} !== ''"));
    looks_on.wait("document.querySelector('.knobs').hidden");
    assert_eq!(browser.complaints, Vec::<String>::new());
    assert_eq!(looks_on.complaints, Vec::<String>::new());
}
