//! What a request wants of an offer, and the attributes that an offer has.

use crate::name::{Location, ObjectName};
use crate::raise;
use crate::report::{Report, code};
use crate::words;
use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::fmt;

/// Attributes of an offer by name; numbers are recognised by their form.
pub type Attributes = BTreeMap<String, String>;

/// Requirements and preferences, as they stand in a dictionary after the word `trade`.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Wanted {
    among: Vec<String>,
    requirements: Vec<Requirement>,
    preferences: Vec<Preference>,
    spread: bool,
}

/// `attribute OPERATOR value`.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Requirement {
    attribute: String,
    operator: Operator,
    value: String,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Operator {
    Is,
    IsNot,
    Less,
    AtMost,
    More,
    AtLeast,
}

/// In the order in which they are looked for, so that no operator hides in a longer one.
const OPERATORS: [(&str, Operator); 6] = [
    ("!=", Operator::IsNot),
    ("<=", Operator::AtMost),
    (">=", Operator::AtLeast),
    ("<", Operator::Less),
    (">", Operator::More),
    ("=", Operator::Is),
];

/// The best offer has the least, or the most, of an attribute.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Preference {
    attribute: String,
    most: bool,
}

/// Reads `attribute=value ...`.
///
/// # Errors
/// Which word is none.
pub fn attributes(text: &str) -> Result<Attributes, String> {
    let words = words::texts(text).map_err(|error| error.to_string())?;
    let read = words.into_iter().map(|word| {
        let pair = word.split_once('=');
        let pair = pair.filter(|(name, _)| is_attribute(name));
        pair.map(|(name, value)| (name.to_owned(), value.to_owned()))
            .ok_or_else(|| format!("`{}` is no attribute; write NAME=VALUE", word))
    });
    read.collect()
}

fn is_attribute(text: &str) -> bool {
    let plain = |letter: char| letter.is_ascii_alphanumeric() || "_-.".contains(letter);
    !text.is_empty() && text.chars().all(plain)
}

impl Wanted {
    /// Reads what stands in the dictionary for `index` after the word `trade`. These are requirements
    /// (`arm=left`, `price<=3`, `!=`, `<`, `>=`, `>`), `-least ATTRIBUTE`, `-most ATTRIBUTE`, `-among
    /// DAEMON,DAEMON` for those daemons only, and `-spread` for equal offers that take turns.
    ///
    /// # Errors
    /// The word that is none of these.
    pub fn read(index: &str, words: &[String]) -> Result<Self, Report> {
        let wrong =
            |text: String| raise!(code::SYNTAX, "the dictionary's `{index} trade ...`: {text}");
        let mut wanted = Self::default();
        let mut words = words.iter();
        while let Some(word) = words.next() {
            let mut next = |what: &str| {
                let given = words.next().cloned();
                given.ok_or_else(|| wrong(format!("after {word} stands {what}")))
            };
            match word.as_str() {
                "-among" => {
                    let daemons = next("DAEMON,DAEMON")?;
                    for daemon in daemons.split(',') {
                        let Some(Location::Alias(daemon)) = Location::parse(daemon) else {
                            return Err(wrong(format!("`{daemon}` is no daemon's name")));
                        };
                        wanted.among.push(daemon);
                    }
                }
                "-least" | "-most" => wanted.preferences.push(Preference {
                    attribute: next("an attribute")?,
                    most: word == "-most",
                }),
                "-spread" => wanted.spread = true,
                _ => match Requirement::read(word) {
                    Some(requirement) => wanted.requirements.push(requirement),
                    None => {
                        return Err(wrong(format!(
                            "`{word}` is no requirement; write ATTRIBUTE=VALUE (or !=, <, <=, >, >=), \
                             -least ATTRIBUTE, -most ATTRIBUTE, -among DAEMON,DAEMON or -spread"
                        )));
                    }
                },
            }
        }
        Ok(wanted)
    }

    /// The daemons that may be asked; none said: all.
    pub(super) fn among(&self) -> &[String] {
        &self.among
    }

    /// Whether equal offers take turns, those with the fewest requests under way first.
    pub(super) fn is_spread(&self) -> bool {
        self.spread
    }

    /// Whether an offer meets all requirements.
    #[must_use]
    pub fn is_met_by(&self, attributes: &Attributes) -> bool {
        let mut requirements = self.requirements.iter();
        requirements.all(|requirement| requirement.is_met_by(attributes))
    }

    /// Which of two offers is preferred by its attributes: `Less` for the first. An offer that lacks an
    /// attribute comes after those that have it.
    #[must_use]
    pub fn compare(&self, one: &Attributes, other: &Attributes) -> Ordering {
        let compared = self.preferences.iter().map(|preference| {
            let name = &preference.attribute;
            match (one.get(name), other.get(name)) {
                (Some(one), Some(other)) if preference.most => order(other, one),
                (Some(one), Some(other)) => order(one, other),
                (Some(_), None) => Ordering::Less,
                (None, Some(_)) => Ordering::Greater,
                (None, None) => Ordering::Equal,
            }
        });
        compared.fold(Ordering::Equal, Ordering::then)
    }

    /// Nobody offers what is wanted; `said` is what they do offer.
    pub(crate) fn unmet(&self, name: &ObjectName, said: &[String]) -> Report {
        let said = match said {
            [] => "no daemon offers the class".to_owned(),
            said => format!("there is: {}", said.join("; ")),
        };
        raise!(
            code::DAEMON,
            "`{name}`: nobody offers `{}` as it is wanted ({self}); {said}; a daemon offers it by \
             `args.offers.{0}` of its task, or `sorm CTRL -offer {0} 'ATTRIBUTE=VALUE'`",
            name.class()
        )
    }
}

impl fmt::Display for Wanted {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut parts = vec!["trade".to_owned()];
        for one in &self.requirements {
            let sign = OPERATORS.iter().find(|(_, known)| *known == one.operator);
            let sign = sign.map_or("=", |(sign, _)| *sign);
            parts.push(format!("{}{sign}{}", one.attribute, one.value));
        }
        for one in &self.preferences {
            let which = if one.most { "-most" } else { "-least" };
            parts.push(format!("{which} {}", one.attribute));
        }
        if !self.among.is_empty() {
            parts.push(format!("-among {}", self.among.join(",")));
        }
        if self.spread {
            parts.push("-spread".to_owned());
        }
        f.write_str(&parts.join(" "))
    }
}

impl Requirement {
    fn read(word: &str) -> Option<Self> {
        let found = OPERATORS.iter().find_map(|(sign, operator)| {
            let (attribute, value) = word.split_once(sign)?;
            is_attribute(attribute).then(|| Self {
                attribute: attribute.to_owned(),
                operator: *operator,
                value: value.to_owned(),
            })
        });
        found.filter(|requirement| !requirement.value.is_empty())
    }

    /// An attribute that an offer lacks meets nothing.
    fn is_met_by(&self, attributes: &Attributes) -> bool {
        let Some(value) = attributes.get(&self.attribute) else {
            return false;
        };
        let order = order(value, &self.value);
        match self.operator {
            Operator::Is => order.is_eq(),
            Operator::IsNot => order.is_ne(),
            Operator::Less => order.is_lt(),
            Operator::AtMost => order.is_le(),
            Operator::More => order.is_gt(),
            Operator::AtLeast => order.is_ge(),
        }
    }
}

/// As numbers when both are, else as texts.
fn order(one: &str, other: &str) -> Ordering {
    match (one.parse::<f64>(), other.parse::<f64>()) {
        (Ok(one), Ok(other)) if !one.is_nan() && !other.is_nan() => {
            one.partial_cmp(&other).unwrap_or(Ordering::Equal)
        }
        _ => one.cmp(other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wanted(text: &str) -> Result<Wanted, Report> {
        let words = words::split(text).unwrap();
        let words: Vec<String> = words.into_iter().map(|word| word.text).collect();
        Wanted::read("SCALE", &words)
    }

    #[test]
    fn requirements_compare_numbers_as_numbers_and_words_as_words() {
        let offer = attributes("arm=left price=10 'note=two words'").unwrap();
        for met in [
            "",
            "arm=left",
            "arm!=right",
            "price=10.0",
            "price>9",
            "price<=10",
            "price>=10",
            "'note=two words'",
        ] {
            assert!(wanted(met).unwrap().is_met_by(&offer), "{met}");
        }
        for unmet in ["arm=right", "price<9", "price>10", "speed>0", "speed!=1"] {
            assert!(!wanted(unmet).unwrap().is_met_by(&offer), "{unmet}");
        }
    }

    #[test]
    fn preferences_are_looked_at_in_their_order() {
        let wanted = wanted("-least price -most speed").unwrap();
        let offer = |text: &str| attributes(text).unwrap();
        let order = |one: &str, other: &str| wanted.compare(&offer(one), &offer(other));
        assert_eq!(order("price=9", "price=10"), Ordering::Less);
        assert_eq!(
            order("price=9 speed=1", "price=9 speed=2"),
            Ordering::Greater
        );
        assert_eq!(order("price=9", ""), Ordering::Less);
        assert_eq!(order("", ""), Ordering::Equal);
    }

    #[test]
    fn what_is_no_requirement_is_refused_by_name_and_the_rest_is_printed_as_read() {
        for wrong in ["arm", "=left", "arm=", "-least", "-among", "-among a,,b"] {
            let report = wanted(wrong).unwrap_err();
            assert!(report.text.contains("SCALE trade"), "{wrong}");
        }
        let text = "arm=left price<=3 -least price -most speed -among d1,d2";
        assert_eq!(wanted(text).unwrap().to_string(), format!("trade {text}"));
    }
}
