//! Children that are woken by others and given their turns at once.

use super::*;
use crate::context::Child;

type Order = Rc<RefCell<Vec<&'static str>>>;

/// A child that does this in each of its turns.
fn child(cx: &Context, mut turn: impl FnMut() + 'static) -> Rc<Child> {
    let turns = poll_fn(move |_| {
        turn();
        Poll::Pending
    });
    Rc::new(cx.spawn_child(turns))
}

/// A child that notes its turns, of which it has had the first.
fn noting(bench: &Bench, slot: u16, name: &'static str, order: &Order) -> Rc<Child> {
    let noted = order.clone();
    let child = child(&bench.caller(slot), move || noted.borrow_mut().push(name));
    bench.settle();
    order.borrow_mut().clear();
    child
}

/// Wakes the children, then asks for the first of them.
fn asks(bench: &Bench, wakes: &[&Rc<Child>], order: &Order) {
    let cx = bench.caller(100);
    let (noted, wakes) = (order.clone(), wakes.iter().copied().cloned());
    let wakes: Vec<_> = wakes.collect();
    let asking = async move {
        for child in &wakes {
            child.wake();
        }
        let given = cx.give_turn(&wakes[0]);
        let said = if given { "given" } else { "not given" };
        noted.borrow_mut().push(said);
    };
    bench.processor.spawn(asking, None);
}

#[test]
fn a_child_that_was_woken_has_its_turn_before_that_of_who_asks_for_it_ends() {
    for hands_over in [true, false] {
        let bench = Bench::new(hands_over);
        let order = Order::default();
        let first = noting(&bench, 101, "first", &order);
        let second = noting(&bench, 102, "second", &order);
        asks(&bench, &[&first, &second], &order);
        bench.settle();
        let expected = if hands_over {
            ["first", "given", "second"]
        } else {
            ["not given", "first", "second"]
        };
        assert_eq!(*order.borrow(), expected);
    }
}

#[test]
fn whoever_was_ready_before_a_child_has_its_turn_before_it() {
    let bench = Bench::new(true);
    let order = Order::default();
    let [first, second] =
        [(101, "first"), (102, "second")].map(|(slot, name)| noting(&bench, slot, name, &order));
    // The second is not the next one.
    asks(&bench, &[&second], &order);
    first.wake();
    bench.settle();
    assert_eq!(*order.borrow(), ["not given", "first", "second"]);
}

#[test]
fn a_child_that_nobody_has_woken_or_that_has_ended_has_no_turn() {
    let bench = Bench::new(true);
    let order = Order::default();
    let ended = Rc::new(bench.caller(101).spawn_child(async {}));
    let idle = noting(&bench, 102, "idle", &order);
    asks(&bench, &[&ended, &ended], &order);
    let (cx, noted) = (bench.caller(100), order.clone());
    let asking = async move {
        assert!(!cx.give_turn(&idle));
        noted.borrow_mut().push("not woken");
    };
    bench.processor.spawn(asking, None);
    bench.settle();
    assert_eq!(*order.borrow(), ["not given", "not woken"]);
}

/// Children each of which wakes another one in its turn and asks for it; how often they had their turns, and how
/// many of them at most within one another.
struct Circle {
    children: Rc<RefCell<Vec<Rc<Child>>>>,
    turns: Rc<Cell<u32>>,
    deepest: Rc<Cell<u32>>,
}

impl Circle {
    /// Each asks for the next, and the last for the first, until there were so many turns.
    fn of(bench: &Bench, count: usize, until: u32) -> Self {
        let circle = Self {
            children: Rc::default(),
            turns: Rc::default(),
            deepest: Rc::default(),
        };
        let depth = Rc::new(Cell::new(0));
        for number in 0..count {
            let cx = bench.caller(200 + u16::try_from(number).unwrap());
            let children = circle.children.clone();
            let (turns, deepest) = (circle.turns.clone(), circle.deepest.clone());
            let (own, depth) = (cx.clone(), depth.clone());
            let child = child(&cx, move || {
                let next = children.borrow().get((number + 1) % count).cloned();
                let Some(next) = next.filter(|_| turns.get() < until) else {
                    return;
                };
                turns.set(turns.get() + 1);
                depth.set(depth.get() + 1);
                deepest.set(deepest.get().max(depth.get()));
                next.wake();
                own.give_turn(&next);
                depth.set(depth.get() - 1);
            });
            // Nothing is woken before all are there.
            bench.settle();
            let children = circle.children.clone();
            children.borrow_mut().push(child);
        }
        circle.turns.set(0);
        circle.deepest.set(0);
        circle
    }
}

#[test]
fn children_that_wake_each_other_for_ever_leave_everybody_else_their_turns() {
    for count in [2, 3, 10] {
        let bench = Bench::new(true);
        let circle = Circle::of(&bench, count, u32::MAX);
        let order = Order::default();
        let other = noting(&bench, 300, "other", &order);
        circle.children.borrow()[0].wake();
        for round in 1..1_000 {
            let before = circle.turns.get();
            assert!(bench.processor.poll_ready(0));
            assert!(circle.turns.get() - before <= MOST + 1);
            other.wake();
            // The turn of one of the circle, and then its own.
            for _ in 0..2 {
                assert!(bench.processor.poll_ready(0));
            }
            assert_eq!(order.borrow().len(), round);
        }
        assert!(circle.deepest.get() <= DEEPEST + 1);
    }
}

#[test]
fn turns_within_turns_of_children_are_none_too_many_and_none_too_few() {
    for (count, hands_over) in [(2, true), (2, false), (10, true), (10, false)] {
        const MANY: u32 = 100_000;
        let bench = Bench::new(hands_over);
        let circle = Circle::of(&bench, count, MANY);
        circle.children.borrow()[0].wake();
        bench.settle();
        assert_eq!(circle.turns.get(), MANY);
        let deepest = circle.deepest.get();
        assert_eq!(deepest > 1, hands_over);
        assert!(deepest <= DEEPEST + 1);
    }
}

#[test]
fn a_panic_in_a_turn_that_was_given_is_none_of_who_gave_it() {
    let bench = Bench::new(true);
    let order = Order::default();
    let turns = Cell::new(0);
    let breaks = child(&bench.caller(101), move || {
        turns.set(turns.get() + 1);
        assert!(turns.get() < 2, "on purpose");
    });
    bench.settle();
    for _ in 0..2 {
        asks(&bench, &[&breaks], &order);
        bench.settle();
    }
    // The first asker was not cut off; for the second one there is no child any more.
    assert_eq!(*order.borrow(), ["given", "not given"]);
}
