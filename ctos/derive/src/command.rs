//! `#[derive(Command)]`.

use heck::ToSnakeCase;
use proc_macro2::TokenStream;
use quote::quote;
use syn::{Attribute, DeriveInput, Error, Expr, Lit, LitInt, LitStr, Meta, Result, Type};

/// What `#[command(...)]` says.
struct Options {
    reply: Option<Type>,
    code: LitInt,
    name: Option<LitStr>,
}

/// The implementation of `Command` for the type.
pub(crate) fn derive(input: &DeriveInput) -> Result<TokenStream> {
    let options = options(input)?;
    let doc = doc(&input.attrs);
    let Some(doc) = doc else {
        return Err(Error::new_spanned(
            &input.ident,
            "a command needs a line of documentation: it is its help, `/// Greets somebody.`",
        ));
    };
    if let Some(parameter) = input.generics.params.first() {
        return Err(Error::new_spanned(
            parameter,
            "a command is one type: its code names its data, so it cannot be generic",
        ));
    }
    let ident = &input.ident;
    let name = options
        .name
        .map_or_else(|| ident.to_string().to_snake_case(), |name| name.value());
    let code = options.code;
    let reply = options
        .reply
        .map_or_else(|| quote!(()), |reply| quote!(#reply));
    Ok(quote! {
        impl ::ctos::message::Command for #ident {
            type Reply = #reply;
            const CODE: u16 = {
                let code: u16 = #code;
                assert!(
                    code < ::ctos::message::SYSTEM_COMMANDS,
                    "codes from 0xff00 on belong to the runtime"
                );
                code
            };
            const NAME: &'static str = #name;
            const DOC: &'static str = #doc;
        }
    })
}

fn options(input: &DeriveInput) -> Result<Options> {
    let mut attributes = input.attrs.iter();
    let Some(attribute) = attributes.find(|attribute| attribute.path().is_ident("command")) else {
        return Err(Error::new_spanned(
            &input.ident,
            "say what it answers and its code: `#[command(reply = String, code = 0x0001)]`",
        ));
    };
    let (mut reply, mut code, mut name) = (None, None, None);
    attribute.parse_nested_meta(|meta| {
        if meta.path.is_ident("reply") {
            reply = Some(meta.value()?.parse()?);
        } else if meta.path.is_ident("code") {
            let number: LitInt = meta.value()?.parse()?;
            number.base10_parse::<u16>()?;
            code = Some(number);
        } else if meta.path.is_ident("name") {
            name = Some(named(meta.value()?.parse()?)?);
        } else {
            return Err(meta.error("there are `reply`, `code` and `name`"));
        }
        Ok(())
    })?;
    let code = code.ok_or_else(|| {
        Error::new_spanned(
            attribute,
            "it has no `code`, the number in the header: `code = 0x0001`",
        )
    })?;
    Ok(Options { reply, code, name })
}

fn named(name: LitStr) -> Result<LitStr> {
    let text = name.value();
    let allowed = |c: char| c.is_ascii_alphanumeric() || c == '_';
    if text.is_empty() || !text.chars().all(allowed) {
        return Err(Error::new_spanned(
            name,
            "a command's name is of letters, digits and `_`, because nets name it",
        ));
    }
    Ok(name)
}

/// The first paragraph of the documentation, on one line.
pub(crate) fn doc(attributes: &[Attribute]) -> Option<String> {
    let lines = attributes.iter().filter_map(|attribute| {
        let Meta::NameValue(meta) = &attribute.meta else {
            return None;
        };
        match &meta.value {
            Expr::Lit(literal) if meta.path.is_ident("doc") => match &literal.lit {
                Lit::Str(text) => Some(text.value().trim().to_owned()),
                _ => None,
            },
            _ => None,
        }
    });
    let paragraph: Vec<String> = lines.take_while(|line| !line.is_empty()).collect();
    (!paragraph.is_empty()).then(|| paragraph.join(" "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_the_type_in_small_letters() {
        for (name, snake) in [
            ("Greet", "greet"),
            ("OpenHand", "open_hand"),
            ("HTTPGet", "http_get"),
            ("Move6D", "move6_d"),
            ("Already_Split", "already_split"),
        ] {
            assert_eq!(name.to_snake_case(), snake);
        }
    }

    #[test]
    fn mistakes_are_told_in_words() {
        for (text, said) in [
            ("/// Doc.\nstruct A;", "say what it answers and its code"),
            (
                "/// Doc.\n#[command(reply = u8)]\nstruct A;",
                "it has no `code`",
            ),
            ("#[command(code = 1)]\nstruct A;", "a line of documentation"),
            (
                "/// Doc.\n#[command(code = 1, kode = 2)]\nstruct A;",
                "there are `reply`, `code` and `name`",
            ),
            (
                "/// Doc.\n#[command(code = 70000)]\nstruct A;",
                "number too large",
            ),
            (
                "/// Doc.\n#[command(code = 1, name = \"a b\")]\nstruct A;",
                "because nets name it",
            ),
            (
                "/// Doc.\n#[command(code = 1)]\nstruct A<T>(T);",
                "cannot be generic",
            ),
        ] {
            let input: DeriveInput = syn::parse_str(text).unwrap();
            let error = derive(&input).unwrap_err().to_string();
            assert!(error.contains(said), "{text}: {error}");
        }
    }

    #[test]
    fn the_help_is_the_first_paragraph() {
        let text =
            "/// Opens the hand\n/// wide.\n///\n/// And more.\n#[command(code = 1)]\nstruct A;";
        let input: DeriveInput = syn::parse_str(text).unwrap();
        assert_eq!(doc(&input.attrs).unwrap(), "Opens the hand wide.");
    }
}
