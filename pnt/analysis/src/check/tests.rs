use std::{collections::BTreeSet, fmt::Write as _};

use ctos::diagnostic::{Severity, Source};
use proptest::prelude::*;

use super::{proof::DEADLOCK, *};
use crate::analysis::verdict::Engine;
use pnt_language::format;

const DISPATCHER: &str = include_str!("../../../tests/nets/dispatcher.net");
const VISION: &str = include_str!("../../../tests/nets/vision.net");
const MOTION: &str = include_str!("../../../tests/nets/motion.net");

fn net(name: &str, text: &str) -> Arc<Net> {
    Arc::new(pnt_language::compile::net(&Source::new(name, text)).unwrap_or_else(|f| panic!("{f}")))
}

fn check_all(texts: &[&str]) -> (Report, Vec<Finding>) {
    let nets: Vec<Arc<Net>> = texts
        .iter()
        .map(|text| {
            let name = text.split_whitespace().nth(1).unwrap_or("test");
            net(&format!("{name}.net"), text)
        })
        .collect();
    let (report, findings) = check(&nets, &Limits::default());
    (report, findings.into_sorted())
}

/// Asserts that there is exactly one finding with this code, that it stands at `place`, and
/// returns its message.
fn the(findings: &[Finding], code: &str, place: &str) -> String {
    let found: Vec<&Finding> = findings.iter().filter(|f| f.code == code).collect();
    let [finding] = found.as_slice() else {
        panic!("not one {code} in {findings:#?}")
    };
    assert_eq!(finding.place.as_ref().unwrap().to_string(), place);
    assert!(finding.help.is_some(), "{finding} does not say what to do");
    finding.message.clone()
}

/// The same for the only finding of a compilation.
fn compile_finding(text: &str, code: &str, place: &str) -> String {
    let findings = pnt_language::compile::net(&Source::new("n.net", text)).unwrap_err();
    the(&findings.into_sorted(), code, place)
}

#[test]
fn the_nets_of_the_case_study_are_sound_and_nothing_in_them_is_idle() {
    let (report, findings) = check_all(&[DISPATCHER, VISION, MOTION]);
    assert!(findings.is_empty(), "{findings:#?}");
    assert!(report.proved && report.markings > 50, "{report:?}");
}

#[test]
fn two_requests_to_one_coordinator_never_mix_their_answers() {
    let requester = "net a
place p = 1, q = 1, p2, q2
coordinator c : x, y
transition ask_x
  in p
  ask c x
  out p2
transition ask_y
  in q
  ask c y
  out q2
transition again
  in p2, q2
  out p, q
";
    let coordinator = "net c
place done
serves a : x, y ; done done
transition do_x
  in I_x
  do x
  out done
transition do_y
  in I_y
  do y
  out done
";
    let nets = [net("a", requester), net("c", coordinator)];
    let (system, findings) = System::compose(&nets);
    assert!(findings.is_empty(), "{findings}");
    let model = Model::of_system(&system);
    let space = crate::analysis::explicit::explore(&model, &Limits::default());
    let index = |name: &str| system.places().iter().position(|p| p.name == name).unwrap();
    let active = [index("a.ask_x_active"), index("a.ask_y_active")];
    assert!(space.complete() && space.dead.is_empty());
    assert!(
        crate::analysis::returns::returns(&space, usize::MAX)
            .unwrap()
            .reversible
    );
    // No marking has both requests active and an answer on its way.
    let mixed = space.nearest(|marking| {
        active.iter().all(|place| marking[*place] > 0) && marking[index("a.O_c")] > 0
    });
    assert_eq!(mixed, None);
}

#[test]
fn a_dead_end_is_found_with_a_shortest_way_to_it() {
    let text = "net n
place a = 1, b = 1, a1, b1, done
transition first_a
  in a
  out a1
transition then_b
  in a1, b
  out done
transition first_b
  in b
  out b1
transition then_a
  in b1, a
  out done
transition again
  in done
  out a, b
";
    let (_, findings) = check_all(&[text]);
    let message = the(&findings, "pnt::check::deadlock", "n.net:2:21");
    assert!(
        message.contains(
            "after n.first_a, n.first_b, the marking is n.a1, n.b1; no transition can fire"
        ),
        "{message}"
    );
}

#[test]
fn a_net_that_is_dead_from_the_start_or_ends_empty_is_told_so() {
    let dead = "there is a deadlock: from the start, the marking is empty; no transition can fire";
    let ends = "the nets can stop short of rest: after n.eat, the marking is empty; no transition can fire";
    for (tokens, told) in [(0, dead), (1, ends)] {
        let text = format!("net n\nplace p = {tokens}\ntransition eat\n  in p\n");
        let options = Options::new(Rule::Alone, Limits::default());
        let proof = prove(&[net("n.net", &text)], &options, &mut |_| {}).unwrap();
        let findings = proof.findings.into_sorted();
        assert_eq!(the(&findings, "pnt::check::deadlock", "n.net:2:7"), told);
    }
}

#[test]
fn a_place_that_grows_is_found_with_the_round_that_feeds_it() {
    let text = "net n\nplace a = 1, b, heap\ntransition go\n  in a\n  out b, heap\ntransition back\n  in b\n  out a\n";
    let (report, findings) = check_all(&[text]);
    let message = the(&findings, "pnt::check::unbounded", "n.net:2:17");
    assert!(
        message.contains("`n.heap` can collect tokens without bound"),
        "{message}"
    );
    assert!(!report.proved);
}

#[test]
fn a_lone_enabling_function_is_no_way_out_but_a_pair_is() {
    let text = "net n\nplace a = 1, b\ntransition go\n  in a\n  out b\ntransition again\n  in b\n  when more\n  out a\n";
    let (_, findings) = check_all(&[text]);
    let message = the(&findings, "pnt::check::deadlock", "n.net:2:14");
    assert!(
        message.ends_with("after n.go, the marking is n.b; no transition is sure to fire"),
        "{message}"
    );
    let pair = format!("{text}transition done\n  in b\n  when not more\n  out a\n");
    let (report, findings) = check_all(&[&pair]);
    assert!(findings.is_empty() && report.proved, "{findings:#?}");
}

#[test]
fn a_loop_without_a_way_back_is_found() {
    let text = "net n\nplace a = 1, b, c\ntransition leave\n  in a\n  out b\ntransition there\n  in b\n  out c\ntransition back\n  in c\n  out b\n";
    let (_, findings) = check_all(&[text]);
    let message = the(&findings, "pnt::check::no_return", "n.net:2:14");
    assert!(
        message.contains("after n.leave, the marking is n.b; no way leads back"),
        "{message}"
    );
}

#[test]
fn a_transition_of_no_use_and_a_place_of_no_use_are_warnings() {
    let text = "net n\nplace a = 1, never, spare\ntransition live\n  in a\n  out a\ntransition idle\n  in never\n  out a\n";
    let (report, findings) = check_all(&[text]);
    the(&findings, "pnt::check::never_fires", "n.net:6:12");
    the(&findings, "pnt::app::unused_place", "n.net:2:21");
    assert!(findings.iter().all(|f| f.severity == Severity::Warning));
    assert!(report.proved);
}

#[test]
fn a_command_without_an_answer_is_found() {
    let silent = DISPATCHER.replace("  write calibration_failed\n", "");
    let (_, findings) = check_all(&[&silent, VISION, MOTION]);
    let dead = findings
        .iter()
        .find(|f| f.code == "pnt::check::deadlock")
        .unwrap();
    assert!(
        dead.message
            .contains("calibrate_camera in progress in dispatcher"),
        "{dead}"
    );
    assert!(
        dead.message.contains("dispatcher.init_calib fails"),
        "{dead}"
    );
}

#[test]
fn a_second_answer_to_one_command_is_found() {
    let text = "net n
place free = 1, busy, more
command go -> gone
transition begin
  in free
  tape go
  out busy
transition half
  in busy
  out more
  write gone
transition end
  in more
  out free
  write gone
";
    let (_, findings) = check_all(&[text]);
    let message = the(&findings, "pnt::check::answer", "n.net:12:12");
    assert!(
        message.contains("after command go to n, n.begin, n.half"),
        "{message}"
    );
}

#[test]
fn a_request_that_the_coordinator_drops_is_found_in_the_composed_app() {
    let drops = VISION.replace("out ready, VC_done", "out ready");
    let (_, findings) = check_all(&[DISPATCHER, &drops, MOTION]);
    let dead = findings
        .iter()
        .find(|f| f.code == "pnt::check::deadlock")
        .unwrap();
    assert!(
        dead.message.contains("vision.do_find_spot completes"),
        "{dead}"
    );
    assert!(
        dead.message.contains("dispatcher.find_spot_active"),
        "{dead}"
    );
    // A request has its author's name, and what happens to it.
    assert!(
        dead.message.contains("dispatcher.find_spot starts"),
        "{dead}"
    );
    assert!(!dead.message.contains("start_"), "{dead}");
}

#[test]
fn a_request_without_failure_branch_to_a_coordinator_that_can_fail_is_a_warning() {
    let stubborn = DISPATCHER.replace(
        "  ask vision find_spot\n  out spot_done\n  fail spot_done\n",
        "  ask vision find_spot\n  out spot_done\n",
    );
    let (report, findings) = check_all(&[&stubborn, VISION, MOTION]);
    the(
        &findings,
        "pnt::app::asked_for_ever",
        "dispatcher.net:36:12",
    );
    assert!(report.proved && findings.len() == 1);
}

#[test]
fn an_action_that_can_fail_halfway_is_found_to_lose_its_semaphore() {
    let text = "net n\nplace free = 1, busy, lost\ncommand go -> gone\ntransition take\n  in free\n  tape go\n  out busy\ntransition work\n  in busy\n  do work\n  out free\n  fail lost\n  write gone\n";
    let (_, findings) = check_all(&[text]);
    let message = the(&findings, "pnt::check::deadlock", "n.net:2:23");
    assert!(message.contains("n.work fails"), "{message}");
}

#[test]
fn too_many_markings_are_not_called_a_proof() {
    let nets = [net("d", DISPATCHER), net("v", VISION), net("m", MOTION)];
    let limits = Limits {
        markings: 10,
        ..Limits::default()
    };
    let (report, findings) = check(&nets, &limits);
    assert!(!report.proved && findings.has_errors());
    assert!(findings.to_string().contains("not proved: more than"));
}

#[test]
fn a_net_or_place_or_request_that_no_net_has_is_found_where_it_is_named() {
    let out = |to: &str| format!("net n\nplace a = 1\ntransition t\n  in a\n  out a, {to}\n");
    let other = "net other\nplace p1 = 1\ntransition t\n  in p1\n  out p1\n";
    let (_, findings) = check_all(&[&out("p1@ather"), other]);
    let message = the(&findings, "pnt::app::unknown_net", "n.net:5:10");
    assert_eq!(message, "the app has no net `ather`");
    assert_eq!(findings[0].help.as_deref(), Some("did you mean `other`?"));
    let (_, findings) = check_all(&[&out("p2@other"), other]);
    the(&findings, "pnt::app::unknown_place", "n.net:5:10");

    let (_, findings) = check_all(&[DISPATCHER, MOTION]);
    the(&findings, "pnt::app::unknown_net", "dispatcher.net:11:13");
    let fewer = MOTION
        .replace("move_robot, find_pos ;", "move_robot ;")
        .replace("in I_find_pos", "in MC_failed");
    let (_, findings) = check_all(&[DISPATCHER, VISION, &fewer]);
    the(
        &findings,
        "pnt::app::unknown_request",
        "dispatcher.net:10:34",
    );
    let nobody = VISION.replace("serves dispatcher", "serves planner");
    let (_, findings) = check_all(&[DISPATCHER, &nobody, MOTION]);
    the(&findings, "pnt::app::not_served", "dispatcher.net:11:13");
    let (_, findings) = check_all(&[DISPATCHER, VISION, MOTION, VISION]);
    the(&findings, "pnt::app::duplicate_net", "vision.net:1:5");
}

#[test]
fn names_that_one_net_does_not_know_are_found_at_once() {
    let unknown = "net n\nplace a = 1\ntransition t\n  in a, b\n  out aa\n";
    let findings = pnt_language::compile::net(&Source::new("n.net", unknown))
        .unwrap_err()
        .into_sorted();
    let shown: Vec<String> = findings.iter().map(ToString::to_string).collect();
    assert_eq!(
        shown[0],
        "n.net:4:9: error: net `n` has no place `b` (did you mean `a`?)"
    );
    assert_eq!(
        shown[1],
        "n.net:5:7: error: net `n` has no place `aa` (did you mean `a`?)"
    );
}

#[test]
fn each_rule_inside_a_net_has_its_finding() {
    let net = |rest: &str| format!("net n\nplace a = 1, b\n{rest}");
    let one = |rest: &str, code: &str, place: &str| compile_finding(&net(rest), code, place);
    one(
        "place a\ntransition t\n  in a, b\n",
        "pnt::net::duplicate",
        "n.net:3:7",
    );
    one(
        "transition t\n  in a\ntransition t\n  in b\n",
        "pnt::net::duplicate",
        "n.net:5:12",
    );
    one(
        "transition t\n  in a, a\n",
        "pnt::net::duplicate",
        "n.net:4:9",
    );
    one(
        "transition t\n  in a\n  reset c\n",
        "pnt::net::unknown_place",
        "n.net:5:9",
    );
    one(
        "transition t\n  in a\n  reset b, b\n",
        "pnt::net::duplicate",
        "n.net:5:12",
    );
    one("safe c\n", "pnt::net::unknown_place", "n.net:3:6");
    one(
        "place c = 6 capacity 5\n",
        "pnt::net::over_capacity",
        "n.net:3:7",
    );
    one(
        "transition t\n  in a\n  idempotent\n",
        "pnt::net::cannot_fail",
        "n.net:3:12",
    );
    one(
        "coordinator c : x\ntransition t\n  in a\n  ask c x\n  idempotent\n",
        "pnt::net::cannot_fail",
        "n.net:4:12",
    );
    one(
        "transition t\n  out a\n",
        "pnt::net::no_input",
        "n.net:3:12",
    );
    one(
        "transition t\n  in a@m\n",
        "pnt::net::remote_input",
        "n.net:4:8",
    );
    one(
        "transition t\n  in a\n  fail b\n",
        "pnt::net::cannot_fail",
        "n.net:5:8",
    );
    one(
        "transition t\n  in a\n  within 1 s\n",
        "pnt::net::cannot_fail",
        "n.net:3:12",
    );
    one(
        "transition t\n  in a\n  tape go\n",
        "pnt::net::unknown_symbol",
        "n.net:5:8",
    );
    one(
        "command go -> gone\ntransition t\n  in a\n  write done\n",
        "pnt::net::unknown_symbol",
        "n.net:6:9",
    );
    one(
        "transition t\n  in a\n  ask c x\n",
        "pnt::net::unknown_coordinator",
        "n.net:5:7",
    );
    one(
        "coordinator c : x\ntransition t\n  in a\n  ask c y\n",
        "pnt::net::unknown_request",
        "n.net:6:9",
    );
    one("coordinator n : x\n", "pnt::net::itself", "n.net:3:13");
    one(
        "serves m : x ; done a\nserves k : y ; done b\n",
        "pnt::net::second_requester",
        "n.net:4:8",
    );
    one(
        "coordinator c : x\ntransition t\n  in a\n  ask c x\n  within 1 s\n",
        "pnt::net::limit_of_request",
        "n.net:4:12",
    );
    one(
        "command go -> gone\ncoordinator c : x\ntransition t\n  tape go\n  ask c x\n",
        "pnt::net::lost_command",
        "n.net:5:12",
    );
}

#[test]
fn functions_that_no_library_offers_are_found() {
    let names = FunctionNames {
        actions: ["validate_path", "plan_paths", "find_pos"]
            .map(String::from)
            .into(),
        ..FunctionNames::default()
    };
    let mut findings = Findings::new();
    functions(&net("motion.net", MOTION), &names, &mut findings);
    let shown: Vec<String> = findings
        .into_sorted()
        .iter()
        .map(ToString::to_string)
        .collect();
    assert_eq!(shown.len(), 3, "{shown:#?}");
    assert!(shown[0].starts_with(
        "motion.net:12:8: error: the library of net `motion` has no enabling function `path_given`"
    ));
    assert!(shown[2].ends_with("no local function `plan_path` (did you mean `plan_paths`?)"));
}

#[test]
fn a_token_for_a_full_place_is_found_before_it_is_sent() {
    // Two orders may be sent for each part that is fetched; the shelf takes one.
    let sender = "net a\nplace free = 2\ncommand order -> sent\ntransition send\n  in free\n  tape order\n  out shelf@b\n  write sent\n";
    let shelf = |capacity: u32| {
        format!(
            "net b\nplace shelf capacity {capacity}\ntransition fetch\n  in shelf\n  out free@a\n"
        )
    };
    let (_, found) = check_all(&[sender, &shelf(1)]);
    let message = the(&found, "pnt::check::overfilled", "a.net:4:12");
    assert!(
        message.contains("tokens of `a.send` can find no room in `b.shelf`"),
        "{message}"
    );
    let (report, found) = check_all(&[sender, &shelf(2)]);
    assert!(report.proved && found.is_empty(), "{found:#?}");
}

#[test]
fn room_that_is_kept_for_a_running_action_is_no_room() {
    // The part that is made has its room in `out` from the start; with room for one the two wait for
    // each other.
    let found = |capacity: u32| {
        let text = format!(
            "net n\nplace raw = 1, other = 1, out capacity {capacity}\ntransition make\n  in raw\n  do make\n  out out\ntransition bring\n  in other\n  out out\ntransition take\n  in out*2\n  out raw, other\n"
        );
        check_all(&[&text]).1
    };
    assert!(found(1).iter().any(|f| f.code == "pnt::check::deadlock"));
    assert!(found(2).is_empty());
}

/// The errors with which the executor, or the check before a boot, refuses these nets.
fn refused_by_the_boot(texts: &[Source], limits: &Limits) -> Vec<String> {
    let (mut nets, mut findings) = (Vec::new(), Findings::new());
    for source in texts {
        match pnt_language::compile::net(source) {
            Ok(net) => nets.push(Arc::new(net)),
            Err(found) => findings.extend(found),
        }
    }
    if !findings.has_errors() {
        findings = check(&nets, limits).1;
    }
    errors(&findings)
}

fn errors(findings: &Findings) -> Vec<String> {
    let errors = findings.iter().filter(|f| f.severity == Severity::Error);
    errors.map(ToString::to_string).collect()
}

/// The errors of `ctos net check`, and whether it says that all is sound.
fn refused_by_a_check(texts: &[Source], limits: &Limits) -> (Vec<String>, bool) {
    let (mut nets, mut findings) = (Vec::new(), Findings::new());
    for source in texts {
        match format::read_source(source).and_then(|file| file.compile()) {
            Ok(net) => nets.push(Arc::new(net)),
            Err(found) => findings.extend(found),
        }
    }
    let mut sound = !findings.has_errors();
    if sound {
        for nets in systems(&nets) {
            let options = Options {
                engines: Engines::Both,
                ..Options::new(Rule::of(&nets), *limits)
            };
            match prove(&nets, &options, &mut |_| {}) {
                Ok(proof) => {
                    sound &= proof.sound() == Some(true);
                    findings.extend(proof.findings);
                }
                Err(found) => {
                    sound = false;
                    findings.extend(found);
                }
            }
        }
    }
    (errors(&findings), sound)
}

/// Asserts that the check refuses what the boot refuses, with the same words.
fn one_verdict(texts: &[Source], markings: usize) {
    let limits = Limits {
        markings,
        ..Limits::default()
    };
    let boot = refused_by_the_boot(texts, &limits);
    let (check, sound) = refused_by_a_check(texts, &limits);
    for error in &boot {
        // Beyond a limit, the check looks for more than the boot.
        let same = |other: &String| {
            let limit = ": error: not proved: ";
            other == error || error.contains(limit) && other.contains(limit)
        };
        assert!(check.iter().any(same), "not said: {error}\nbut: {check:#?}");
    }
    assert!(boot.is_empty() || !sound, "called sound: {boot:#?}");
    assert!(check.is_empty() || !sound);
}

#[test]
fn what_the_boot_refuses_of_the_nets_of_this_project_a_check_refuses_with_the_same_words() {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
    let mut read = 0;
    for folder in ["configs/nets", "pnt/tests/nets", "tests/tutorial"] {
        let Ok(files) = std::fs::read_dir(format!("{root}/{folder}")) else {
            continue;
        };
        let files = files.filter_map(|file| Some(file.ok()?.path()));
        let nets = files.filter(|path| path.extension().is_some_and(|e| e == "net"));
        let texts: Vec<Source> = nets.filter_map(|path| Source::read(&path).ok()).collect();
        read += texts.len();
        one_verdict(&texts, 100_000);
        for text in &texts {
            one_verdict(std::slice::from_ref(text), 100_000);
        }
        // The same with a transition that needs nothing.
        for text in &texts {
            let more = "place extra capacity 1\ntransition nothing\n  out extra\ntransition away\n  in extra\n";
            let more = format!("{}\n{more}", text.text());
            one_verdict(&[Source::new(text.name(), more)], 100_000);
        }
    }
    assert!(read >= 8, "{read}");
}

#[test]
fn a_transition_without_input_is_refused_also_where_a_capacity_bounds_it() {
    let text = "net w6\nplace a capacity 1\ntransition nothing\n  out a\ntransition t\n  in a\n";
    let texts = [Source::new("w6.net", text)];
    one_verdict(&texts, 100_000);
    let (errors, sound) = refused_by_a_check(&texts, &Limits::default());
    assert!(!sound);
    let said = "w6.net:3:12: error: transition `nothing` takes nothing and would fire for ever";
    assert!(
        errors.iter().any(|error| error.starts_with(said)),
        "{errors:#?}"
    );
}

/// Lines of a transition, right and wrong.
const LINES: [&str; 22] = [
    "in a",
    "in b*2",
    "in c",
    "in a, c",
    "out a",
    "out b",
    "out c*2",
    "out b, c",
    "read a",
    "inhibit b",
    "reset c",
    "time 1 s",
    "priority 1",
    "when f",
    "when not f",
    "tape go",
    "write gone",
    "do f",
    "fail a",
    "out q",
    "when not",
    "within 1 s",
];

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn what_the_boot_refuses_of_any_net_a_check_refuses_with_the_same_words(
        transitions in prop::collection::vec(prop::collection::vec(0_usize..22, 1..5), 1..5),
        tokens in prop::collection::vec((0_u32..3, prop::option::of(2_u32..4)), 3),
        commands in any::<bool>(),
    ) {
        let mut text = String::from("net n\n");
        for (name, (tokens, capacity)) in ["a", "b", "c"].iter().zip(tokens) {
            let _ = write!(text, "place {name} = {tokens}");
            if let Some(capacity) = capacity {
                let _ = write!(text, " capacity {capacity}");
            }
            text.push('\n');
        }
        if commands {
            text.push_str("command go -> gone\n");
        }
        for (number, lines) in transitions.iter().enumerate() {
            let _ = writeln!(text, "transition t{number}");
            for line in lines {
                let _ = writeln!(text, "  {}", LINES[*line]);
            }
        }
        one_verdict(&[Source::new("n.net", text)], 3_000);
    }
}

#[test]
fn a_label_says_what_the_place_holds_and_what_is_needed() {
    let text = "net n\nplace bin = 3, robot = 1\ntransition load\n  in bin*2, robot\n  out robot\n";
    let (_, findings) = check_all(&[text]);
    the(&findings, "pnt::check::deadlock", "n.net:2:7");
    assert_eq!(findings[0].label, "this holds 1 then, and `load` needs 2");
    assert!(!findings[0].help.as_deref().unwrap().contains("when"));
}

#[test]
fn a_sequence_is_whole_and_each_dead_marking_has_one_when_that_is_asked_for() {
    // A chain of 40 steps, at each of whose last three places the token may be lost.
    let mut text = String::from("net n\nplace p0 = 1\n");
    for step in 0..40 {
        let next = step + 1;
        let _ = write!(
            text,
            "place p{next}\ntransition t{step}\n  in p{step}\n  out p{next}\n"
        );
        if step >= 37 {
            let _ = write!(
                text,
                "place lost{step}\ntransition l{step}\n  in p{step}\n  out lost{step}\n"
            );
        }
    }
    let nets = [net("n.net", &text)];
    let limits = Limits::default();
    for (deadlocks, shown) in [(1, 1), (3, 3), (100, 4)] {
        let options = Options {
            deadlocks,
            engines: Engines::Both,
            ..Options::new(Rule::of(&nets), limits)
        };
        let proof = prove(&nets, &options, &mut |_| {}).unwrap();
        assert_eq!(proof.sound(), Some(false));
        let dead: Vec<_> = proof
            .counterexamples
            .iter()
            .filter(|c| c.code == DEADLOCK)
            .collect();
        assert_eq!(dead.len(), shown);
        for one in &dead {
            assert!(one.sequence.len() >= 38);
            assert_eq!(
                proof.model.replay(&one.sequence).as_ref(),
                Some(&one.marking)
            );
        }
        let found: Vec<_> = proof
            .findings
            .iter()
            .filter(|f| f.code == DEADLOCK)
            .collect();
        assert_eq!(found.len(), shown);
        assert!(
            found[0].message.contains("after n.t0, n.t1, n.t2, "),
            "{}",
            found[0]
        );
    }
}

/// A ring of parts, with a command beside it or without: nothing is wrong with it.
fn ring(parts: usize, command: bool) -> Arc<Net> {
    let mut text = format!(
        "net ring\nplace left = {parts}, right, idle = 1\ntransition go\n  in left\n  out right\ntransition back\n  in right\n  out left\ntransition look\n  in idle\n  out idle\n"
    );
    if command {
        text = text.replace(
            "transition look\n",
            "command see -> seen\ntransition look\n  tape see\n  write seen\n",
        );
    }
    net("ring.net", &text)
}

/// Whether the check before a boot that looks this far refuses a net, and whether a check that looks further says that
/// it will.
fn refused_and_foretold(net: &Arc<Net>, boot: Limits, engines: Engines) -> (bool, bool) {
    let nets = [Arc::clone(net)];
    let refused = check(&nets, &boot).1.has_errors();
    let options = Options {
        boot,
        engines,
        ..Options::new(Rule::of(&nets), Limits::default())
    };
    let proof = prove(&nets, &options, &mut |_| {}).unwrap();
    assert_eq!(proof.sound(), Some(true), "{:?}", proof.findings);
    let mut told = proof.findings.iter();
    (
        refused,
        told.any(|finding| finding.code == "pnt::check::too_large"),
    )
}

#[test]
fn a_check_that_proves_more_than_the_boot_looks_at_says_that_the_boot_refuses_it() {
    for command in [false, true] {
        let ring = ring(50, command);
        let (report, findings) = check(&[Arc::clone(&ring)], &Limits::default());
        assert!(findings.is_empty() && report.markings >= 51, "{report:?}");
        let all = usize::try_from(report.markings).unwrap();
        for markings in [1, all - 2, all - 1, all, all + 1, 10 * all] {
            let boot = Limits {
                markings,
                ..Limits::default()
            };
            for engines in [Engines::Both, Engines::Explicit, Engines::Symbolic] {
                let (refused, foretold) = refused_and_foretold(&ring, boot, engines);
                assert_eq!(refused, markings < all, "{markings} of {all}");
                assert_eq!(foretold, refused, "{markings} of {all}, {engines:?}");
            }
        }
    }
}

#[test]
fn so_it_does_where_the_boot_has_too_little_memory() {
    let mut refusals = BTreeSet::new();
    for command in [false, true] {
        let ring = ring(1_000, command);
        for bytes in [12, 14, 15, 16, 18].map(|power| 1 << power) {
            let boot = Limits {
                bytes,
                ..Limits::default()
            };
            for engines in [Engines::Both, Engines::Explicit] {
                let (refused, foretold) = refused_and_foretold(&ring, boot, engines);
                assert_eq!(foretold, refused, "{bytes}, {engines:?}");
                refusals.insert(refused);
            }
        }
    }
    assert_eq!(refusals.len(), 2);
}

#[test]
fn nets_with_a_deadlock_are_not_sound_also_where_no_way_to_it_was_found() {
    let mut text = String::from("net lines\n");
    for line in 0..8 {
        let _ = write!(
            text,
            "place a{line} = 1, b{line}, c{line}\ntransition f{line}\n  in a{line}\n  out b{line}\ntransition g{line}\n  in b{line}\n  out c{line}\n"
        );
    }
    let nets = [net("lines.net", &text)];
    let mut without_a_way = 0;
    for bytes in (1_000..40_000).step_by(200) {
        let limits = Limits {
            bytes,
            ..Limits::default()
        };
        let options = Options {
            engines: Engines::Symbolic,
            ..Options::new(Rule::Closed, limits)
        };
        let proof = prove(&nets, &options, &mut |_| {}).unwrap();
        assert_ne!(proof.sound(), Some(true), "{bytes}");
        let symbolic = proof.verdict.engine == Engine::Symbolic;
        without_a_way += usize::from(symbolic && proof.counterexamples.is_empty());
    }
    assert!(without_a_way > 0);
}
