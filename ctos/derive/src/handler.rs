//! `#[handler]`.

use proc_macro2::{Span, TokenStream};
use quote::{format_ident, quote, quote_spanned};
use syn::{
    Attribute, Error, FnArg, GenericArgument, ImplItem, ImplItemFn, ItemImpl, PathArguments,
    PathSegment, Result, ReturnType, Type, spanned::Spanned,
};

/// A mark, and what the method takes after the context if it takes the place of one of the trait's.
type Mark = (&'static str, &'static [&'static str]);

const MARKS: [Mark; 8] = [
    ("command", &[]),
    ("phase", &["phase"]),
    ("quiesce", &["reason"]),
    ("stop", &["reason"]),
    ("chassis_down", &["chassis"]),
    ("chassis_up", &["chassis"]),
    ("task_down", &["task", "reason"]),
    ("task_up", &["task"]),
];

/// The methods as they are, the list of commands, and the implementation of `EventHandler`.
pub(crate) fn expand(arguments: &TokenStream, mut input: ItemImpl) -> Result<TokenStream> {
    if !arguments.is_empty() {
        return Err(Error::new_spanned(arguments, "`#[handler]` takes nothing"));
    }
    if let Some((_, path, _)) = &input.trait_ {
        return Err(Error::new_spanned(
            path,
            "`#[handler]` stands on `impl TYPE { ... }`; it writes the `impl EventHandler` itself",
        ));
    }
    let mut arms = Vec::new();
    let mut infos = Vec::new();
    let mut hooks = Vec::new();
    for item in &mut input.items {
        let ImplItem::Fn(method) = item else { continue };
        match take_mark(&mut method.attrs) {
            Some(("command", _)) => {
                let (arm, command) = arm(method)?;
                arms.push(arm);
                infos.push(quote!(<#command as ::ctos::message::Command>::INFO));
            }
            Some((mark, names)) => hooks.push(hook(mark, names, method)?),
            None => {}
        }
    }
    // A task that takes no commands is one; a block without any mark is a mark forgotten.
    if arms.is_empty() && hooks.is_empty() && !input.items.is_empty() {
        return Err(Error::new_spanned(
            &input.self_ty,
            "none of its methods is marked `#[command]`, nor as one of the trait's own",
        ));
    }
    let (generics, _, bounds) = input.generics.split_for_impl();
    let name = &input.self_ty;
    let count = infos.len();
    Ok(quote! {
        #input

        impl #generics #name #bounds {
            /// What it takes, for its registration.
            pub const COMMANDS: [::ctos::message::CommandInfo; #count] = [#(#infos),*];
        }

        impl #generics ::ctos::task::EventHandler for #name #bounds {
            async fn handle(
                &mut self,
                cx: &::ctos::task::Context,
                message: ::ctos::message::Message,
            ) -> ::ctos::task::Handled {
                match message.command() {
                    #(#arms)*
                    _ => cx.default_processing(message),
                }
            }

            #(#hooks)*
        }
    })
}

/// Takes the mark off a method.
fn take_mark(attributes: &mut Vec<Attribute>) -> Option<Mark> {
    let mut marks = attributes
        .iter()
        .enumerate()
        .filter_map(|(index, attribute)| {
            let mark = MARKS
                .iter()
                .find(|(name, _)| attribute.path().is_ident(name));
            Some((index, *mark?))
        });
    let (index, mark) = marks.next()?;
    attributes.remove(index);
    Some(mark)
}

/// The arm of `handle` that calls a method, and the type of its command.
fn arm(method: &ImplItemFn) -> Result<(TokenStream, Type)> {
    let mut inputs = method.sig.inputs.iter();
    if !matches!(inputs.next(), Some(FnArg::Receiver(receiver)) if receiver.reference.is_some()) {
        return Err(Error::new_spanned(
            &method.sig,
            "a command's method begins with `&mut self` or `&self`",
        ));
    }
    let arguments: Vec<&Type> = inputs.filter_map(typed).collect();
    let takes_context = matches!(arguments.first(), Some(Type::Reference(_)));
    let rest = arguments
        .get(usize::from(takes_context)..)
        .unwrap_or_default();
    let (command, replier) = match rest {
        [command] => ((*command).clone(), false),
        [command, replier] if is_replier_of(replier, command) => ((*command).clone(), true),
        _ => {
            return Err(Error::new_spanned(
                &method.sig,
                "a command's method takes `request: C`, before it `cx: &Context` if it needs that, and after it `reply: Replier<C>` if it answers by itself",
            ));
        }
    };
    let name = &method.sig.ident;
    let cx = takes_context.then(|| quote!(cx,));
    let wait = method.sig.asyncness.map(|_| quote!(.await));
    // What does not fit is shown at the method: at the type that it returns, or at its name.
    let at = match &method.sig.output {
        ReturnType::Type(_, output) => output.span(),
        ReturnType::Default => name.span(),
    };
    let at = Span::call_site().located_at(at);
    let body = if replier {
        quote_spanned!(at=> self.#name(#cx request, reply)#wait)
    } else if returns_result(&method.sig.output) {
        quote_spanned!(at=> reply.ok(self.#name(#cx request)#wait?))
    } else {
        quote_spanned!(at=> reply.ok(self.#name(#cx request)#wait))
    };
    let arm = quote! {
        <#command as ::ctos::message::Command>::CODE => {
            let (request, reply) = message.open::<#command>()?;
            #body
        }
    };
    Ok((arm, command))
}

/// A method of the trait that calls a marked one.
fn hook(mark: &str, names: &[&str], method: &ImplItemFn) -> Result<TokenStream> {
    if method.sig.inputs.len() != names.len() + 2 {
        let expected = names.join(", ");
        return Err(Error::new_spanned(
            &method.sig,
            format!(
                "a method for `#[{mark}]` takes `&mut self, cx, {expected}`, as the trait's does"
            ),
        ));
    }
    let own: Vec<_> = names.iter().map(|name| format_ident!("{name}")).collect();
    let types = method.sig.inputs.iter().skip(2).filter_map(typed);
    let trait_name = format_ident!("{mark}");
    let name = &method.sig.ident;
    let wait = method.sig.asyncness.map(|_| quote!(.await));
    Ok(quote! {
        async fn #trait_name(
            &mut self,
            cx: &::ctos::task::Context,
            #(#own: #types),*
        ) -> ::ctos::task::Handled {
            Self::#name(self, cx, #(#own),*)#wait
        }
    })
}

/// The type of an argument that is not `self`, which comes first.
fn typed(argument: &FnArg) -> Option<&Type> {
    match argument {
        FnArg::Typed(typed) => Some(&typed.ty),
        FnArg::Receiver(_) => None,
    }
}

/// The last name of a type's path.
fn last(path: &Type) -> Option<&PathSegment> {
    match path {
        Type::Path(path) => path.path.segments.last(),
        _ => None,
    }
}

fn is_replier_of(replier: &Type, command: &Type) -> bool {
    let Some(last) = last(replier).filter(|last| last.ident == "Replier") else {
        return false;
    };
    let PathArguments::AngleBracketed(arguments) = &last.arguments else {
        return false;
    };
    matches!(arguments.args.first(), Some(GenericArgument::Type(of)) if of == command)
}

fn returns_result(output: &ReturnType) -> bool {
    match output {
        ReturnType::Type(_, output) => {
            last(output).is_some_and(|last| last.ident == "Result" || last.ident == "Answer")
        }
        ReturnType::Default => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(text: &str) -> String {
        let input: ItemImpl = syn::parse_str(text).unwrap();
        match expand(&TokenStream::new(), input) {
            Ok(written) => panic!("{text} became {written}"),
            Err(error) => error.to_string(),
        }
    }

    #[test]
    fn mistakes_are_told_in_words() {
        for (text, said) in [
            (
                "impl A { fn f(&mut self, r: Go) {} }",
                "none of its methods is marked",
            ),
            (
                "impl T for A { #[command] fn f(&mut self, r: Go) {} }",
                "writes the `impl EventHandler` itself",
            ),
            (
                "impl A { #[command] fn f(r: Go) {} }",
                "begins with `&mut self`",
            ),
            (
                "impl A { #[command] fn f(&mut self) {} }",
                "takes `request: C`",
            ),
            (
                "impl A { #[command] fn f(&mut self, r: Go, reply: Replier<Stop>) {} }",
                "takes `request: C`",
            ),
            (
                "impl A { #[command] fn f(&mut self, r: Go) {} #[phase] async fn p(&mut self) {} }",
                "takes `&mut self, cx, phase`",
            ),
        ] {
            let found = error(text);
            assert!(found.contains(said), "{text}: {found}");
        }
    }

    #[test]
    fn a_mark_is_taken_off_and_the_rest_stays() {
        let mut method: ImplItemFn =
            syn::parse_str("#[inline] #[command] fn f(&mut self, r: Go) {}").unwrap();
        let mark = take_mark(&mut method.attrs);
        assert_eq!(mark.map(|(name, _)| name), Some("command"));
        assert_eq!(method.attrs.len(), 1);
    }
}
