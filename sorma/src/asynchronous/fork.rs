//! The class `fork`: several requests at once.

use super::answer::{begin, request};
use crate::ipc::answer::split;
use crate::object::{self, Context, Outcome, ServiceObject, Waiting};
use crate::options::OptionTable;
use crate::raise;
use crate::report::{Report, code as general};
use crate::request::{Reply, Request};
use crate::transport::Transport;
use crate::words;
use std::sync::LazyLock;

/// No more requests than this in one.
const MOST: usize = 10_000;

#[derive(Debug, Clone)]
pub(super) struct Fork {
    width: i64,
}

impl Default for Fork {
    fn default() -> Self {
        Self { width: 4 }
    }
}

pub(super) static OPTIONS: LazyLock<OptionTable<Fork>> = LazyLock::new(|| {
    OptionTable::new(
        "asks several objects at once. EXEC 'REQUEST' 'REQUEST' ...: the replies, a line each in the order of the \
         requests; their floats in FMSG, one reply's after the other's; their return codes in IMSG; the first of these \
         that is not 0 is the answer's",
    )
    .int(
        "width",
        1..=1000,
        "",
        "how many are under way at once",
        |fork: &mut Fork| &mut fork.width,
    )
});

impl Fork {
    async fn exec(&mut self, cx: &Waiting<'_>, io: &mut Transport) -> Outcome {
        // A text that is one quoted word has lost its quotes on the way.
        let words = match io.text.parse::<Request>() {
            Ok(_) => vec![io.text.clone()],
            Err(_) => split(&io.text)?,
        };
        if words.is_empty() || words.len() > MOST {
            return Err(raise!(
                general::VALUE,
                "EXEC takes 1 to {MOST} requests, each quoted as one word, not {}",
                words.len()
            ));
        }
        let from = io.from.clone();
        let requests = words.iter().map(|text| request(text, &from));
        let requests = requests.collect::<Result<Vec<Request>, Report>>()?;
        let width = usize::try_from(self.width).unwrap_or(1);
        let replies = cx.fork(requests, width, io).await;
        io.empty();
        let mut lines = Vec::new();
        for reply in replies {
            io.ints.push(i64::from(reply.body.code));
            io.floats.extend(&reply.body.floats);
            if io.code == 0 {
                io.code = reply.body.code;
            }
            lines.push(line(&reply));
        }
        io.text = lines.join("\n");
        Ok(())
    }
}

/// A reply as a line; its reports have gone to the caller, and opaque bytes have no text.
fn line(reply: &Reply) -> String {
    reply.to_text().unwrap_or_else(|error| {
        let code = reply.body.code;
        format!(
            "{} RET {code} {}",
            reply.name,
            words::quoted(&error.to_string())
        )
    })
}

impl ServiceObject for Fork {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        io: &'a mut Transport,
    ) -> object::Later<'a> {
        if io.text.is_empty() {
            // Said by itself, so that it names the object's form.
            return Some(Box::pin(std::future::ready(Err(raise!(
                general::VALUE,
                "EXEC takes requests, each quoted as one word: `{} EXEC 'foo.a EXEC' 'bar EXEC'`",
                begin(cx.name())
            )))));
        }
        Some(Box::pin(self.exec(cx, io)))
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        OPTIONS.ctrl(self, io);
        Ok(())
    }

    fn dump(&self) -> String {
        OPTIONS.dump(self)
    }
}
