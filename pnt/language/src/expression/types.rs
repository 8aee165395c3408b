//! The types and units of an expression, found before it is evaluated.

use cel::{
    IdedExpr,
    common::{
        ast::{CallExpr, Expr, LiteralValue, SourceInfo, operators},
        types::CelDouble,
    },
};
use ctos::diagnostic::Finding;

use super::{Scope, part};
use crate::{data::Kind, draft::Word};

/// What is known of a part of an expression.
#[derive(Debug, Clone, Copy)]
struct Typed {
    kind: Kind,
    /// Whether it is a whole number as written, which may stand for a float.
    whole: bool,
}

impl Typed {
    fn of(kind: Kind) -> Self {
        Self { kind, whole: false }
    }

    fn is_number(self) -> bool {
        matches!(self.kind, Kind::Int | Kind::Float(_))
    }
}

pub(super) struct Types<'a> {
    word: &'a Word,
    scope: Scope<'a>,
    info: &'a SourceInfo,
}

type Result<T> = std::result::Result<T, Finding>;

impl<'a> Types<'a> {
    pub(super) fn new(word: &'a Word, scope: Scope<'a>, info: &'a SourceInfo) -> Self {
        Self { word, scope, info }
    }

    /// The type of the whole, which must fit the wanted one.
    pub(super) fn whole(&mut self, tree: &mut IdedExpr, wanted: Option<Kind>) -> Result<Kind> {
        let found = self.of(tree)?;
        let Some(wanted) = wanted else {
            return Ok(found.kind);
        };
        match (wanted, found.kind) {
            (Kind::Float(Some(one)), Kind::Float(Some(other))) if one != other => {
                Err(self.units(tree.id, one, other))
            }
            (Kind::Float(_), Kind::Float(_) | Kind::Int) => Ok(wanted),
            (wanted, found) if wanted == found => Ok(wanted),
            (wanted, found) => Err(self
                .wrong(
                    "pnt::net::type",
                    tree.id,
                    format!("this is of type `{found}`, and `{wanted}` is wanted"),
                )
                .help(match wanted {
                    Kind::Bool => "compare it with something: `count < 3`",
                    Kind::Int => {
                        "write `int(...)` around it to cut off what stands behind the point"
                    }
                    Kind::Text => "write `string(...)` around it",
                    Kind::Float(_) => "write a number",
                })),
        }
    }

    fn wrong(&self, code: &'static str, id: u64, message: String) -> Finding {
        let length = self.word.text.len();
        let range = self.info.offset_for(id).map(|(start, stop)| {
            let index = |at: u32| usize::try_from(at).unwrap_or(length).min(length);
            let (start, stop) = (index(start), index(stop));
            start..stop.max(start)
        });
        let range = range.unwrap_or(0..length);
        Finding::error(code, message).at(part(self.word, range))
    }

    fn units(&self, id: u64, one: &str, other: &str) -> Finding {
        let text = format!("`{one}` and `{other}` are two units");
        self.wrong("pnt::net::unit", id, text)
            .help("convert one of them by a factor: a product has no unit until it is stored")
    }

    fn of(&self, tree: &mut IdedExpr) -> Result<Typed> {
        let id = tree.id;
        match &mut tree.expr {
            Expr::Literal(value) => self.literal(id, value),
            Expr::Ident(name) => self.named(id, name),
            Expr::Select(select) if !select.test => {
                let Expr::Ident(name) = &select.operand.expr else {
                    return Err(self.no_part(id));
                };
                let (whole, at) = (format!("{name}.{}", select.field), select.operand.id);
                let typed = self.named(at, &whole)?;
                // It is looked up as one name.
                tree.expr = Expr::Ident(whole);
                Ok(typed)
            }
            Expr::Call(call) => self.call(id, call),
            _ => Err(self.no_part(id)),
        }
    }

    fn no_part(&self, id: u64) -> Finding {
        let text = "a net's expressions have no lists, maps, structures and loops".to_owned();
        self.wrong("pnt::text::expression", id, text)
            .help("they have names of declared data, numbers, texts, operators and a few functions")
    }

    fn literal(&self, id: u64, value: &LiteralValue) -> Result<Typed> {
        Ok(match value {
            LiteralValue::Boolean(_) => Typed::of(Kind::Bool),
            LiteralValue::Double(_) => Typed::of(Kind::Float(None)),
            LiteralValue::String(_) => Typed::of(Kind::Text),
            LiteralValue::Int(_) => Typed {
                kind: Kind::Int,
                whole: true,
            },
            LiteralValue::Bytes(_) | LiteralValue::Null | LiteralValue::UInt(_) => {
                let text = "data is no bytes, no `null` and no unsigned number".to_owned();
                return Err(self.wrong("pnt::text::expression", id, text));
            }
        })
    }

    fn named(&self, id: u64, name: &str) -> Result<Typed> {
        let declared = self.scope.declared;
        if let Some(slot) = declared.slots.iter().find(|slot| slot.name == name) {
            return Ok(Typed::of(slot.kind));
        }
        if let Some(one) = self.scope.parameters.iter().find(|one| one.name == name) {
            return Ok(Typed::of(one.kind));
        }
        if let Some(data) = declared.named(name) {
            let text = format!("`{name}` has fields, and one of them is meant here");
            let fields = declared.slots.get(data.slots.clone()).unwrap_or_default();
            let fields: Vec<&str> = fields.iter().map(|slot| slot.name.as_str()).collect();
            return Err(self
                .wrong("pnt::net::unknown_data", id, text)
                .help(format!("write one of: {}", fields.join(", "))));
        }
        let known = declared.slots.iter().map(|slot| slot.name.as_str());
        let known = known.chain(self.scope.parameters.iter().map(|one| one.name.as_str()));
        Err(self
            .wrong(
                "pnt::net::unknown_data",
                id,
                format!("nothing declares `{name}`"),
            )
            .help("declare it: `data NAME : TYPE`")
            .suggest(name, known))
    }

    fn call(&self, id: u64, call: &mut CallExpr) -> Result<Typed> {
        let name = call.func_name.clone();
        if let Some(target) = call.target.as_deref_mut() {
            return self.method(id, &name, target, &mut call.args);
        }
        match (name.as_str(), call.args.as_mut_slice()) {
            (operators::LOGICAL_AND | operators::LOGICAL_OR, [one, other]) => {
                self.boolean(one)?;
                self.boolean(other)?;
                Ok(Typed::of(Kind::Bool))
            }
            (operators::LOGICAL_NOT, [one]) => {
                self.boolean(one)?;
                Ok(Typed::of(Kind::Bool))
            }
            (operators::CONDITIONAL, [asked, one, other]) => {
                self.boolean(asked)?;
                let kind = self.same(id, one, other)?;
                Ok(Typed::of(kind))
            }
            (operators::EQUALS | operators::NOT_EQUALS, [one, other]) => {
                self.same(id, one, other)?;
                Ok(Typed::of(Kind::Bool))
            }
            (
                operators::LESS
                | operators::LESS_EQUALS
                | operators::GREATER
                | operators::GREATER_EQUALS,
                [one, other],
            ) => {
                let kind = self.same(id, one, other)?;
                match kind {
                    Kind::Bool => Err(self.no_operator(id, &name, "bool")),
                    _ => Ok(Typed::of(Kind::Bool)),
                }
            }
            (operators::ADD | operators::SUBSTRACT, [one, other]) => {
                let kind = self.same(id, one, other)?;
                match (kind, name.as_str()) {
                    (Kind::Text, operators::ADD) | (Kind::Int | Kind::Float(_), _) => {
                        Ok(Typed::of(kind))
                    }
                    (kind, _) => Err(self.no_operator(id, &name, &kind.to_string())),
                }
            }
            (operators::MULTIPLY | operators::DIVIDE | operators::MODULO, [one, other]) => {
                self.product(id, &name, one, other)
            }
            (operators::NEGATE, [one]) => {
                let typed = self.of(one)?;
                match typed.is_number() {
                    true => Ok(Typed::of(typed.kind)),
                    false => Err(self.no_operator(id, "-", &typed.kind.to_string())),
                }
            }
            ("int", [one]) => self.converted(id, one, Kind::Int),
            ("double", [one]) => self.converted(id, one, Kind::Float(None)),
            ("string", [one]) => self.converted(id, one, Kind::Text),
            ("size", [one]) => {
                self.text(one)?;
                Ok(Typed::of(Kind::Int))
            }
            _ => Err(self.no_function(id, &name)),
        }
    }

    fn method(
        &self,
        id: u64,
        name: &str,
        target: &mut IdedExpr,
        arguments: &mut [IdedExpr],
    ) -> Result<Typed> {
        match (name, arguments) {
            ("contains" | "startsWith" | "endsWith", [one]) => {
                self.text(target)?;
                self.text(one)?;
                Ok(Typed::of(Kind::Bool))
            }
            ("size", []) => {
                self.text(target)?;
                Ok(Typed::of(Kind::Int))
            }
            _ => Err(self.no_function(id, name)),
        }
    }

    fn no_function(&self, id: u64, name: &str) -> Finding {
        let known = [
            "int",
            "double",
            "string",
            "size",
            "contains",
            "startsWith",
            "endsWith",
        ];
        self.wrong(
            "pnt::text::expression",
            id,
            format!("a net's expressions have no function `{name}` with these arguments"),
        )
        .help(format!("they have: {}", known.join(", ")))
        .suggest(name, known)
    }

    fn no_operator(&self, id: u64, operator: &str, kind: &str) -> Finding {
        let text = format!("`{}` is not for `{kind}`", operator.trim_matches('_'));
        self.wrong("pnt::net::type", id, text)
            .help("compare it, or convert it with `int(...)`, `double(...)` or `string(...)`")
    }

    fn boolean(&self, tree: &mut IdedExpr) -> Result<()> {
        let found = self.of(tree)?.kind;
        match found {
            Kind::Bool => Ok(()),
            other => Err(self
                .wrong(
                    "pnt::net::type",
                    tree.id,
                    format!("this is of type `{other}`, and yes or no is wanted"),
                )
                .help("compare it with something: `count < 3`")),
        }
    }

    fn text(&self, tree: &mut IdedExpr) -> Result<()> {
        match self.of(tree)?.kind {
            Kind::Text => Ok(()),
            other => Err(self.wrong(
                "pnt::net::type",
                tree.id,
                format!("this is of type `{other}`, and `text` is wanted"),
            )),
        }
    }

    fn converted(&self, id: u64, tree: &mut IdedExpr, kind: Kind) -> Result<Typed> {
        match (self.of(tree)?.kind, kind) {
            (Kind::Bool, Kind::Int | Kind::Float(_)) => Err(self
                .no_operator(id, "int", "bool")
                .help("write `done ? 1 : 0`")),
            (Kind::Float(unit), Kind::Float(None)) => Ok(Typed::of(Kind::Float(unit))),
            _ => Ok(Typed::of(kind)),
        }
    }

    /// The common type of two parts. A whole number as written becomes a float beside a float.
    fn same(&self, id: u64, one: &mut IdedExpr, other: &mut IdedExpr) -> Result<Kind> {
        let (first, second) = (self.of(one)?, self.of(other)?);
        match (first.kind, second.kind) {
            (Kind::Float(Some(one)), Kind::Float(Some(other))) if one != other => {
                Err(self.units(id, one, other))
            }
            (Kind::Float(one), Kind::Float(other)) => Ok(Kind::Float(one.or(other))),
            (Kind::Float(unit), Kind::Int) if second.whole => {
                become_float(other);
                Ok(Kind::Float(unit))
            }
            (Kind::Int, Kind::Float(unit)) if first.whole => {
                become_float(one);
                Ok(Kind::Float(unit))
            }
            (first, second) if first == second => Ok(first),
            (first, second) => Err(self.two_types(id, first, second)),
        }
    }

    fn two_types(&self, id: u64, first: Kind, second: Kind) -> Finding {
        let text = format!("`{first}` and `{second}` stand on the two sides of this");
        let numbers = |kind| matches!(kind, Kind::Int | Kind::Float(_));
        self.wrong("pnt::net::type", id, text)
            .help(match numbers(first) && numbers(second) {
                true => "write `double(...)` around the whole number",
                false => "compare and add what is of one type",
            })
    }

    /// A product or quotient: one unit and a plain number keep the unit; of two units nothing is known.
    fn product(
        &self,
        id: u64,
        operator: &str,
        one: &mut IdedExpr,
        other: &mut IdedExpr,
    ) -> Result<Typed> {
        let (first, second) = (self.of(one)?, self.of(other)?);
        if !(first.is_number() && second.is_number()) {
            let kind = if first.is_number() { second } else { first };
            return Err(self.no_operator(id, operator, &kind.kind.to_string()));
        }
        if operator != operators::MULTIPLY && is_zero(other) {
            return Err(self
                .wrong(
                    "pnt::net::type",
                    other.id,
                    "this divides by zero".to_owned(),
                )
                .help("divide by something else"));
        }
        let kind = match (first.kind, second.kind) {
            (Kind::Int, Kind::Int) => Kind::Int,
            (Kind::Float(one), Kind::Float(other)) => Kind::Float(match (one, other) {
                (unit, None) => unit,
                (None, unit) if operator == operators::MULTIPLY => unit,
                _ => None,
            }),
            (Kind::Float(unit), Kind::Int) if second.whole => {
                become_float(other);
                Kind::Float(unit)
            }
            (Kind::Int, Kind::Float(unit)) if first.whole => {
                become_float(one);
                Kind::Float(unit.filter(|_| operator == operators::MULTIPLY))
            }
            (first, second) => return Err(self.two_types(id, first, second)),
        };
        if operator == operators::MODULO && kind != Kind::Int {
            return Err(self.no_operator(id, operator, &kind.to_string()));
        }
        Ok(Typed::of(kind))
    }
}

fn is_zero(tree: &IdedExpr) -> bool {
    match &tree.expr {
        Expr::Literal(LiteralValue::Int(number)) => *number.inner() == 0,
        Expr::Literal(LiteralValue::Double(number)) => *number.inner() == 0.0,
        _ => false,
    }
}

/// A whole number as written becomes a float.
fn become_float(tree: &mut IdedExpr) {
    if let Expr::Literal(LiteralValue::Int(number)) = &tree.expr {
        // Every whole number that people write is a float.
        #[allow(clippy::cast_precision_loss)]
        let float = *number.inner() as f64;
        tree.expr = Expr::Literal(LiteralValue::Double(CelDouble::from(float)));
    }
}
