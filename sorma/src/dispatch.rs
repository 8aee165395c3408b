//! Requests by name that are met in this process, and lines of text that hold them.

use crate::comm::{Alone, Comm};
use crate::object::Context;
use crate::raise;
use crate::report::{Report, code};
use crate::request::{MOST_NUMBERS, Method, Reply, Request, RequestError};
use crate::sorm::Sorm;
use crate::transport::{Trace, Transport};
use crate::words::{self, LONGEST};
use futures_util::FutureExt as _;

/// So many letters of a request are repeated in what is said about its answer.
const ASKED_SHOWN: usize = 200;

impl Context<'_> {
    /// [`Self::call_by`] for an object of that name.
    ///
    /// # Errors
    /// The name is wrong or cannot be built, or the call ended with an error.
    pub fn call(
        &self,
        name: &str,
        method: Method,
        mut sub: Transport,
        io: &mut Transport,
    ) -> Result<Transport, Report> {
        let object = self.sorm.get(name)?;
        self.call_by(&object, method, &mut sub, io)?;
        Ok(sub)
    }
}

impl Sorm {
    /// Passes a request to its object; the reply always comes, errors, panics and all.
    #[must_use]
    pub fn request(&self, request: Request) -> Reply {
        let Request {
            name,
            method,
            mut body,
        } = request;
        match self.resolve(&name) {
            Ok(handle) => {
                // Only what is done without waiting for anybody.
                let met = self.meet(&Alone, None, (None, &handle), method, &mut body);
                if met.now_or_never().is_none() {
                    let report = raise!(
                        code::UNSUPPORTED,
                        "`{name}` asks other objects and waits for them: it is asked with `Sorm::ask`, in an app that runs"
                    );
                    self.refuse(&mut body, report);
                }
            }
            Err(report) => self.refuse(&mut body, report),
        }
        Reply { name, body }
    }

    /// One line of text in, one line of text out. A line that is not a request is answered in the name
    /// of `sorm`.
    #[must_use]
    pub fn dispatch(&self, line: &str) -> String {
        self.dispatch_from(line, "")
    }

    /// [`Self::dispatch`] for the caller `from`, whose locks count.
    #[must_use]
    pub fn dispatch_from(&self, line: &str, from: &str) -> String {
        match read(line, from) {
            Ok(request) => write(&self.request(request), line),
            Err(answer) => answer,
        }
    }

    /// [`Self::dispatch_from`] for whatever may wait, or be met by another daemon.
    pub async fn tell(&self, comm: &dyn Comm, line: &str, from: &str) -> String {
        self.tell_traced(comm, line, from, Trace::default()).await
    }

    /// [`Self::tell`] for a request that is followed through all that it leads to.
    pub async fn tell_traced(
        &self,
        comm: &dyn Comm,
        line: &str,
        from: &str,
        trace: Trace,
    ) -> String {
        match read(line, from) {
            Ok(mut request) => {
                request.body.trace = trace;
                write(&self.ask(comm, request).await, line)
            }
            Err(answer) => answer,
        }
    }
}

/// Reads a request, or answers that it is none.
fn read(line: &str, from: &str) -> Result<Request, String> {
    let mut request: Request = line
        .parse()
        .map_err(|error: RequestError| refusal("sorm", &error))?;
    from.clone_into(&mut request.body.from);
    Ok(request)
}

/// The reply to `line` as text. One that no line holds is told with what was asked, so that its asker knows what to narrow.
fn write(reply: &Reply, line: &str) -> String {
    reply.to_text().unwrap_or_else(|error| {
        let name = reply.name.to_string();
        if !matches!(error, RequestError::Words(_)) {
            return refusal(&name, &error);
        }
        let Transport { floats, ints, .. } = &reply.body;
        let (floats, ints) = (floats.len(), ints.len());
        let asked: String = line.trim().chars().take(ASKED_SHOWN).collect();
        refusal(
            &name,
            &format!(
                "the answer to `{asked}` has {floats} floats and {ints} ints, and a line of text holds at most {MOST_NUMBERS} of \
                 each and {LONGEST} bytes: ask for less (`help` of the class names options that narrow it), or divide its \
                 input, or ask by reference"
            ),
        )
    })
}

fn refusal(name: &str, error: &impl std::fmt::Display) -> String {
    let report = Report::error(code::SYNTAX, error.to_string());
    let text = words::quoted(&report.to_line());
    format!("{name} RET {} TDBX {text}", report.code)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Class, Context, Dictionary, Outcome, ServiceObject};

    /// Answers with as many floats as its text says.
    struct Many;

    impl ServiceObject for Many {
        fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
            io.floats = vec![0.5; io.text.trim().parse().unwrap()];
            Ok(())
        }

        fn ctrl(&mut self, _cx: &Context<'_>, _io: &mut Transport) -> Outcome {
            Ok(())
        }

        fn dump(&self) -> String {
            String::new()
        }
    }

    #[test]
    fn an_answer_that_no_line_holds_is_told_with_the_request_its_size_and_what_to_do() {
        let sorm = Sorm::new(Dictionary::new());
        sorm.register(Class::new("many", "1", |_, _| Ok(Box::new(Many))));
        let most = format!("many EXEC TMSG {MOST_NUMBERS}");
        let reply: Reply = sorm.dispatch(&most).parse().unwrap();
        assert_eq!(reply.body.floats.len(), MOST_NUMBERS);
        let line = format!("many EXEC TMSG {}", MOST_NUMBERS + 1);
        let reply: Reply = sorm.dispatch(&line).parse().unwrap();
        assert!(!reply.body.is_ok());
        let text = &reply.body.reports[0].text;
        for said in [
            line.as_str(),
            "250001 floats",
            "at most 250000",
            "ask for less",
        ] {
            assert!(text.contains(said), "{said}: {text}");
        }
    }
}
