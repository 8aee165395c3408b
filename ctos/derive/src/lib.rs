//! `#[derive(Command)]` and `#[handler]`: what takes the boilerplate out of commands and event handlers.
//!
//! Used through `ctos::Command` and `ctos::handler`. What they write is what a person would write by
//! hand; nothing is hidden in it. It knows the paths of `ctos` and nothing else of the runtime.

mod command;
mod handler;

use proc_macro::TokenStream;
use syn::{DeriveInput, ItemImpl, parse_macro_input};

/// Makes a type a typed command.
///
/// `#[command(reply = TYPE, code = NUMBER)]` says what the task answers and the code in the header.
/// `name = "TEXT"` is the name in nets, text and logs, by default the type's in snake_case. Without
/// `reply` it answers nothing, `()`. The first paragraph of the documentation is the command's line of
/// help, and has to be there. The type must be serializable both ways.
#[proc_macro_derive(Command, attributes(command))]
pub fn derive_command(input: TokenStream) -> TokenStream {
    let input = parse_macro_input!(input as DeriveInput);
    command::derive(&input)
        .unwrap_or_else(syn::Error::into_compile_error)
        .into()
}

/// Makes an event handler of the methods of a type.
///
/// Each method marked `#[command]` takes one command: `(&mut self, request: C)` or
/// `(&mut self, cx: &Context, request: C)`, `async` or not, and returns the reply, or a `Result` of it.
/// (A reply that is itself a `Result` is therefore returned within another one.)
/// With a last argument `reply: Replier<C>` it answers itself, now or later, and returns `Handled`.
/// Methods marked `#[phase]`, `#[quiesce]`, `#[stop]`, `#[chassis_down]`, `#[chassis_up]`, `#[task_down]` and
/// `#[task_up]` take the place of the trait's methods of those names. Everything else goes to default
/// processing; a task may well take nothing but that.
///
/// The type gets a constant `COMMANDS` for its registration.
#[proc_macro_attribute]
pub fn handler(arguments: TokenStream, input: TokenStream) -> TokenStream {
    let input = parse_macro_input!(input as ItemImpl);
    handler::expand(&arguments.into(), input)
        .unwrap_or_else(syn::Error::into_compile_error)
        .into()
}
