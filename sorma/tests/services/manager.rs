//! The manager as an object, names beside names, locks, two-step commitment, threads and panics.

use ctos::time::{Clock, Instant};
use sorma::report::code;
use sorma::{
    Class, Context, Dictionary, Method, OptionTable, Outcome, Reply, Report, Request,
    ServiceObject, Sorm, Transport, TwoStep, raise,
};
use std::sync::LazyLock;
use std::time::Duration;

/// A purse: gives money in one step or in two.
#[derive(Debug, Clone, Default)]
struct Purse {
    money: i64,
    kept: i64,
}

static PURSE: LazyLock<OptionTable<Purse>> = LazyLock::new(|| {
    OptionTable::new("holds money; EXEC IMSG 1 n puts n in, or takes it out if negative").int(
        "money",
        0..=1_000_000,
        "cent",
        "what is in it",
        |purse: &mut Purse| &mut purse.money,
    )
});

impl Purse {
    fn sum(&self, io: &Transport) -> Result<i64, Report> {
        let [sum] = io.ints.as_slice() else {
            return Err(raise!(code::VALUE, "takes one whole number, the sum"));
        };
        if self.money + sum < 0 {
            return Err(raise!(code::VALUE, "there are only {} cent", self.money));
        }
        Ok(*sum)
    }
}

impl ServiceObject for Purse {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        if io.text == "burn" {
            panic!("it burns");
        }
        self.money += self.sum(io)?;
        io.ints = vec![self.money];
        Ok(())
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        PURSE.ctrl(self, io);
        Ok(())
    }

    fn dump(&self) -> String {
        PURSE.dump(self)
    }

    fn self_test(&mut self, _cx: &Context<'_>) -> Outcome {
        if self.money == 13 {
            return Err(raise!(code::VALUE, "thirteen cent bring bad luck"));
        }
        Ok(())
    }

    fn two_step(&mut self) -> Option<&mut dyn TwoStep> {
        Some(self)
    }
}

impl TwoStep for Purse {
    fn prepare(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        self.kept = self.sum(io)?;
        Ok(())
    }

    fn commit(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        self.money += std::mem::take(&mut self.kept);
        io.ints = vec![self.money];
        Ok(())
    }

    fn abort(&mut self, _cx: &Context<'_>) {
        self.kept = 0;
    }
}

/// Without a second step.
struct Stone;

impl ServiceObject for Stone {
    fn exec(&mut self, _cx: &Context<'_>, _io: &mut Transport) -> Outcome {
        Ok(())
    }

    fn ctrl(&mut self, _cx: &Context<'_>, _io: &mut Transport) -> Outcome {
        Ok(())
    }

    fn dump(&self) -> String {
        String::new()
    }
}

sorma::prototypes! {
    mod purse_codes {
        EMPTY = 101, Error, "the purse is empty", "put something in";
    }
}

fn market_on(clock: Clock) -> Sorm {
    let mut dictionary = Dictionary::new();
    for (name, money) in [("ann", "10"), ("bob", "5"), ("cursed", "13")] {
        let words = ["-money".to_owned(), money.to_owned()];
        dictionary.add(format!("purse.{name}"), words.to_vec());
    }
    let sorm = Sorm::of("market", clock, dictionary);
    let purse = Class::new("purse", "1.0", |_, _| Ok(Box::new(Purse::default())));
    sorm.register(purse.codes(purse_codes::PROTOTYPES));
    sorm.register(Class::new("stone", "1.0", |_, _| Ok(Box::new(Stone))));
    sorm
}

fn market() -> Sorm {
    market_on(Clock::real())
}

fn ask_from(sorm: &Sorm, from: &str, line: &str) -> Transport {
    let answer = sorm.dispatch_from(line, from);
    answer.parse::<Reply>().unwrap().body
}

fn ask(sorm: &Sorm, line: &str) -> Transport {
    ask_from(sorm, "", line)
}

fn money(sorm: &Sorm, name: &str) -> i64 {
    let dump = ask(sorm, &format!("purse.{name} DBX -statistics"));
    assert!(dump.is_ok());
    let dump = sorm.get(&format!("purse.{name}")).unwrap().dump().unwrap();
    dump.strip_prefix("-money ").unwrap().parse().unwrap()
}

fn last(body: &Transport) -> (i32, &str) {
    (body.code, body.reports.last().unwrap().text.as_str())
}

#[test]
fn the_manager_lists_creates_frees_and_explains() {
    let sorm = market();
    assert!(ask(&sorm, "sorm CTRL -create purse.ann -create stone").is_ok());
    assert_eq!(ask(&sorm, "sorm CTRL -list").text, "purse.ann\nsorm\nstone");
    let classes = ask(&sorm, "sorm CTRL -classes").text;
    assert!(
        classes.contains("purse 1.0\n") && classes.contains("sorm "),
        "{classes}"
    );
    let codes = ask(&sorm, "sorm CTRL -codes").text;
    assert!(
        codes.contains("101 error purse the purse is empty: put something in")
            && codes.contains("10 error sorm "),
        "{codes}"
    );
    ask(&sorm, "purse.ann EXEC IMSG 1 -3");
    ask(&sorm, "purse.ann EXEC IMSG 1 -30");
    let statistics = ask(&sorm, "sorm CTRL -statistics").text;
    assert!(
        statistics.contains("purse.ann exec 2 ctrl 1 errors 1"),
        "{statistics}"
    );
    assert!(ask(&sorm, "sorm CTRL -free purse.ann").is_ok());
    assert_eq!(
        money(&sorm, "ann"),
        10,
        "its next use builds it from its recipe"
    );
    let twice = ask(&sorm, "sorm CTRL -free stone -free stone");
    assert_eq!(
        last(&twice),
        (code::NO_OBJECT, "there is no object `stone`")
    );
}

#[test]
fn a_request_to_the_manager_with_a_wrong_word_does_nothing() {
    let sorm = market();
    ask(&sorm, "sorm CTRL -create stone");
    let wrong = ask(&sorm, "sorm CTRL -free stone -fre stone");
    assert_eq!(wrong.code, code::UNKNOWN_OPTION);
    assert_eq!(sorm.objects(), ["sorm", "stone"]);
}

#[test]
fn the_manager_cannot_lock_itself_and_says_so_at_once() {
    let sorm = market();
    let body = ask(&sorm, "sorm CTRL -lock sorm 10");
    assert_eq!(body.code, code::BUSY);
    assert!(
        ask(&sorm, "sorm CTRL -statistics")
            .text
            .contains("sorm is in a call")
    );
}

#[test]
fn an_alias_leads_to_the_same_object_and_never_in_a_circle() {
    let sorm = market();
    assert!(ask(&sorm, "sorm CTRL -alias wallet purse.ann").is_ok());
    assert_eq!(ask(&sorm, "wallet EXEC IMSG 1 5").ints, [15]);
    assert_eq!(ask(&sorm, "purse.ann EXEC IMSG 1 0").ints, [15]);
    assert_eq!(ask(&sorm, "sorm CTRL -aliases").text, "wallet purse.ann");
    for wrong in [
        "-alias wallet wallet",
        "-alias purse.ann stone",
        "-alias other wallet",
        "-alias x purse@d1",
        "-alias 1 stone",
    ] {
        let body = ask(&sorm, &format!("sorm CTRL {wrong}"));
        assert_eq!(body.code, code::SYNTAX, "{wrong}");
    }
    assert!(ask(&sorm, "sorm CTRL -unalias wallet").is_ok());
    assert_eq!(ask(&sorm, "wallet EXEC IMSG 1 5").code, code::UNKNOWN_CLASS);
}

#[test]
fn a_locked_object_serves_its_holder_alone_until_it_is_let_go() {
    let sorm = market();
    assert!(ask_from(&sorm, "ann", "sorm CTRL -lock purse.ann 60").is_ok());
    assert!(ask_from(&sorm, "ann", "purse.ann EXEC IMSG 1 1").is_ok());
    for line in [
        "purse.ann EXEC IMSG 1 1",
        "purse.ann CTRL -money 0",
        "sorm CTRL -free purse.ann",
        "sorm CTRL -lock purse.ann 1",
    ] {
        let body = ask_from(&sorm, "bob", line);
        assert_eq!(body.code, code::LOCKED, "{line}");
        assert!(
            last(&body).1.contains("locked by `ann`"),
            "{line}: {}",
            last(&body).1
        );
    }
    assert_eq!(money(&sorm, "ann"), 11);
    assert!(!ask_from(&sorm, "bob", "sorm CTRL -unlock purse.ann").is_ok());
    assert!(ask_from(&sorm, "ann", "sorm CTRL -unlock purse.ann").is_ok());
    assert!(ask_from(&sorm, "bob", "purse.ann EXEC IMSG 1 1").is_ok());
}

#[test]
fn a_lock_ends_with_its_time_and_with_its_holder() {
    let clock = Clock::real();
    let sorm = market_on(clock);
    assert!(ask_from(&sorm, "ann", "sorm CTRL -lock purse.ann 0").is_ok());
    assert!(ask_from(&sorm, "bob", "purse.ann EXEC IMSG 1 1").is_ok());
    assert!(ask_from(&sorm, "ann", "sorm CTRL -lock purse.ann 60 -lock stone 60").is_ok());
    sorm.release(|from| from == "ann");
    assert!(ask_from(&sorm, "bob", "purse.ann EXEC IMSG 1 1").is_ok());
    assert!(ask_from(&sorm, "bob", "stone EXEC").is_ok());
    let long = ask(&sorm, "sorm CTRL -lock stone 1e9");
    assert_eq!(long.code, code::VALUE);
}

fn request(line: &str) -> Request {
    line.parse().unwrap()
}

#[test]
fn together_all_do_it_or_none() {
    let sorm = market();
    let pay = |sum: i64| {
        vec![
            request(&format!("purse.ann EXEC IMSG 1 -{sum}")),
            request(&format!("purse.bob EXEC IMSG 1 {sum}")),
        ]
    };
    let paid = sorm.together("pay", pay(4)).unwrap();
    assert_eq!(paid[0].body.ints, [6]);
    assert_eq!(paid[1].body.ints, [9]);
    let refused = sorm.together("pay", pay(7)).unwrap_err();
    assert_eq!(refused.text, "`purse.ann` refuses: there are only 6 cent");
    let mut both = pay(6);
    both.push(request("stone EXEC"));
    let refused = sorm.together("pay", both).unwrap_err();
    assert!(refused.text.contains("`stone` has no two-step commitment"));
    assert_eq!((money(&sorm, "ann"), money(&sorm, "bob")), (6, 9));
    assert!(
        ask(&sorm, "purse.ann EXEC IMSG 1 0").is_ok(),
        "nothing is left prepared"
    );
}

#[test]
fn what_is_prepared_by_text_is_kept_from_everybody_until_it_is_committed_or_aborted() {
    let sorm = market();
    let prepare = "sorm CTRL -prepare pay 'purse.ann EXEC IMSG 1 -10'";
    assert!(ask_from(&sorm, "bob", prepare).is_ok());
    assert_eq!(
        ask_from(&sorm, "bob", "purse.ann EXEC IMSG 1 1").code,
        code::LOCKED
    );
    assert_eq!(
        ask_from(&sorm, "eve", "sorm CTRL -commit pay").code,
        code::PREPARED
    );
    assert_eq!(money(&sorm, "ann"), 10, "nothing is to be seen yet");
    let done = ask_from(&sorm, "bob", "sorm CTRL -commit pay");
    assert_eq!(done.text, "purse.ann RET 0 \"\"");
    assert_eq!(money(&sorm, "ann"), 0);
    assert_eq!(
        ask_from(&sorm, "bob", "sorm CTRL -commit pay").code,
        code::PREPARED
    );
    let too_much = "sorm CTRL -prepare pay 'purse.bob EXEC IMSG 1 -10'";
    let refused = ask_from(&sorm, "bob", too_much);
    assert_eq!(last(&refused), (code::VALUE, "there are only 5 cent"));
    assert!(
        ask_from(
            &sorm,
            "bob",
            "sorm CTRL -prepare give 'purse.bob EXEC IMSG 1 -5'"
        )
        .is_ok()
    );
    assert!(ask_from(&sorm, "bob", "sorm CTRL -abort give").is_ok());
    assert_eq!(money(&sorm, "bob"), 5);
}

#[test]
fn what_was_prepared_too_long_ago_is_aborted() {
    let sorm = market();
    let reply = sorm.prepare("pay", request("purse.ann EXEC IMSG 1 -1"), Duration::ZERO);
    assert!(reply.unwrap().body.is_ok());
    assert_eq!(sorm.commit("pay", "").unwrap_err().code, code::PREPARED);
    assert_eq!(ask(&sorm, "purse.ann EXEC IMSG 1 0").ints, [10]);
}

#[test]
fn an_object_that_fails_its_self_test_is_not_built() {
    let sorm = market();
    let body = ask(&sorm, "purse.cursed EXEC IMSG 1 1");
    assert_eq!(
        last(&body),
        (
            code::SELF_TEST,
            "`purse.cursed` does not pass its self-test: thirteen cent bring bad luck"
        )
    );
    assert!(sorm.objects().is_empty());
    assert_eq!(
        ask(&sorm, "purse.ann DBX -test").text,
        "the self-test is passed"
    );
}

#[test]
fn a_panic_is_a_report_and_the_next_use_builds_the_object_anew() {
    let sorm = market();
    ask(&sorm, "purse.ann EXEC IMSG 1 5");
    let body = ask(&sorm, "purse.ann EXEC burn IMSG 1 1");
    assert_eq!(
        last(&body),
        (
            code::PANIC,
            "`purse.ann` panicked: it burns; its next use builds it anew"
        )
    );
    let report = body.reports.last().unwrap();
    assert_eq!(
        (report.object.as_str(), report.process.as_str()),
        ("purse.ann", "market")
    );
    assert_eq!(money(&sorm, "ann"), 10);
}

#[test]
fn a_private_object_stands_in_no_repository() {
    struct Owner(sorma::Owned);
    impl ServiceObject for Owner {
        fn exec(&mut self, cx: &Context<'_>, io: &mut Transport) -> Outcome {
            self.0.exec(cx, io);
            Ok(())
        }
        fn ctrl(&mut self, _cx: &Context<'_>, _io: &mut Transport) -> Outcome {
            Ok(())
        }
        fn dump(&self) -> String {
            String::new()
        }
    }
    let sorm = market();
    sorm.register(Class::new("owner", "1", |_, sorm| {
        Ok(Box::new(Owner(sorm.private("purse.ann")?)))
    }));
    assert_eq!(ask(&sorm, "owner EXEC IMSG 1 5").ints, [15]);
    assert_eq!(sorm.objects(), ["owner"]);
    assert_eq!(ask(&sorm, "purse.ann EXEC IMSG 1 0").ints, [10]);
}

#[test]
fn threads_share_an_object_and_no_call_is_lost() {
    let sorm = market();
    let purse = sorm.get("purse.ann").unwrap();
    let threads: Vec<_> = (0..4)
        .map(|_| {
            let (sorm, purse) = (sorm.clone(), purse.clone());
            std::thread::spawn(move || {
                let mut io = Transport::default();
                for _ in 0..10_000 {
                    io.clear();
                    io.ints.push(1);
                    purse.exec(&sorm, &mut io);
                    assert!(io.is_ok());
                }
            })
        })
        .collect();
    for thread in threads {
        thread.join().unwrap();
    }
    assert_eq!(money(&sorm, "ann"), 40_010);
}

#[test]
fn threads_that_use_a_name_at_once_get_one_object() {
    for _ in 0..50 {
        let sorm = market();
        let threads: Vec<_> = (0..4)
            .map(|_| {
                let sorm = sorm.clone();
                std::thread::spawn(move || ask(&sorm, "purse.ann EXEC IMSG 1 1").is_ok())
            })
            .collect();
        assert!(threads.into_iter().all(|thread| thread.join().unwrap()));
        assert_eq!(money(&sorm, "ann"), 14);
    }
}

#[test]
fn who_asks_first_stands_in_the_audit_trail() {
    let sorm = market();
    ask_from(&sorm, "bob@desk", "purse.ann CTRL -money 7");
    let trail = ask(&sorm, "purse.ann DBX -audit").text;
    assert!(
        trail
            .lines()
            .last()
            .unwrap()
            .ends_with("bob@desk RET 0 \"-money 7\""),
        "{trail}"
    );
    assert!(sorm.now() >= Instant::START);
    let mut io = Transport::text("-audit");
    sorm.get("purse.ann")
        .unwrap()
        .call(&sorm, Method::Dbx, &mut io);
    assert_eq!(io.text, trail);
}
