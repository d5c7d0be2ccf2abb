//! Names for people: lists of known names, and the one that was probably meant.

use std::collections::{HashMap, HashSet};

/// Text after an unknown name: the known names, and the closest one.
pub fn expected_one_of(found: &str, known: &[&str]) -> String {
    if known.is_empty() {
        return "there are none".into();
    }
    format!("expected one of {}{}", listed(known), did_you_mean(found, known.iter().copied()))
}

/// `; did you mean `x`?` with the known name that is closest to `found`; nothing if none is close.
pub fn did_you_mean<'a>(found: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    closest(found, known).map_or(String::new(), |name| format!("; did you mean `{name}`?"))
}

/// Names that are wanted, in the names that there are: the one rule by which data are matched by name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NameMatch {
    /// Position of each wanted name; none of those that are missing.
    pub positions: Vec<Option<usize>>,
    /// Positions of the names that nobody wants.
    pub unused: Vec<usize>,
}

impl NameMatch {
    /// Finds each of the wanted names.
    pub fn of(wanted: &[&str], known: &[&str]) -> Self {
        let places: HashMap<&str, usize> = known.iter().enumerate().map(|(place, name)| (*name, place)).collect();
        let positions: Vec<Option<usize>> = wanted.iter().map(|name| places.get(name).copied()).collect();
        let used: HashSet<usize> = positions.iter().flatten().copied().collect();
        Self { positions, unused: (0..known.len()).filter(|place| !used.contains(place)).collect() }
    }
}

/// Message for names that are missing among the known ones: all of them, each with the closest of the names that are not used.
/// `kind` is what they name, for instance "column". None if nothing is missing.
pub fn missing(kind: &str, missing: &[&str], known: &[&str], unused: &[&str]) -> Option<String> {
    let texts: Vec<String> = missing.iter().map(|name| format!("`{name}`")).collect();
    let texts: Vec<&str> = texts.iter().map(String::as_str).collect();
    let expected = if known.is_empty() { "none".into() } else { listed(known) };
    Some(match missing {
        [] => return None,
        [only] => {
            let meant = did_you_mean(only, unused.iter().copied());
            format!("no {kind} {}, expected it among {expected}{meant}", texts[0])
        }
        _ => {
            // of thousands the first ones show what is wrong
            let meant = missing.iter().take(SHOWN).filter_map(|name| {
                let close = closest(name, unused.iter().copied())?;
                Some(format!("`{close}` for `{name}`"))
            });
            let meant: Vec<String> = meant.collect();
            let meant = if meant.is_empty() { String::new() } else { format!("; did you mean {}?", meant.join(", ")) };
            format!("no {kind}s {}, expected them among {expected}{meant}", listed(&texts))
        }
    })
}

/// Returns true if two names differ in case, punctuation or a unit in brackets only.
pub fn is_respelled(one: &str, other: &str) -> bool {
    is_respelling(&spellings(one), &spellings(other))
}

/// `der(x)` and `der(y)` are two names: only one of them may be without its brackets.
fn is_respelling([one, bare]: &[String; 2], [other, other_bare]: &[String; 2]) -> bool {
    !one.is_empty() && (one == other || one == other_bare) || !other.is_empty() && bare == other
}

/// Names that a message lists.
const SHOWN: usize = 20;

/// The first names, and how many more there are.
pub fn listed(names: &[&str]) -> String {
    match names.get(SHOWN..) {
        Some(more) if !more.is_empty() => format!("{} and {} more", names[..SHOWN].join(", "), more.len()),
        _ => names.join(", "),
    }
}

/// The known name that differs from `found` only in case or punctuation, by a few letters, or because one extends the
/// other. Of several equally close names, the first.
pub fn closest<'a>(found: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let (spelled, found) = (spellings(found), folded(found));
    let ranked = known.into_iter().filter_map(|name| {
        let is_respelled = is_respelling(&spelled, &spellings(name));
        let letters = if is_respelled { 0 } else { difference(&found, &folded(name))? };
        Some((letters, name))
    });
    ranked.min_by_key(|(difference, _)| *difference).map(|(_, name)| name)
}

/// The first of `names`, and its place, that belongs to a column by position and is the name of another one apart from its spelling: case, punctuation
/// and a unit in brackets do not count. Returns that name's place and that of the column whose name it is.
pub fn out_of_order(columns: &[&str], names: &[&str]) -> Option<[usize; 2]> {
    let spellings: Vec<[String; 2]> = columns.iter().map(|column| spellings(column)).collect();
    let mut places = HashMap::new();
    for (place, of) in spellings.iter().enumerate() {
        for spelling in of {
            places.entry(spelling.as_str()).or_insert(place);
        }
    }
    names.iter().take(columns.len()).enumerate().find_map(|(place, name)| {
        let found = self::spellings(name);
        if found.iter().any(|spelling| spellings[place].contains(spelling)) {
            return None;
        }
        found
            .iter()
            .filter(|spelling| !spelling.is_empty())
            .find_map(|spelling| Some([place, *places.get(spelling.as_str())?]))
    })
}

/// A message for [`out_of_order`] names, with both orders; `what` and `of` say whose names and columns they are.
pub fn out_of_order_problem((what, names): (&str, &[&str]), (of, columns): (&str, &[&str])) -> Option<String> {
    let [place, column] = out_of_order(columns, names)?;
    Some(format!(
        "the order of {what} is {}, that of {of} {}: by position `{}` would be `{}`, but its name is that of `{}`; expected the same order, or \
         the names as they are spelled there",
        listed(names),
        listed(columns),
        names[place],
        columns[place],
        columns[column]
    ))
}

/// A name without case and punctuation, with and without the unit in brackets behind it.
fn spellings(name: &str) -> [String; 2] {
    let trimmed = name.trim_end();
    let without = [('[', ']'), ('(', ')')].into_iter().find_map(|(open, close)| {
        let (before, inside) = trimmed.strip_suffix(close)?.rsplit_once(open)?;
        // a unit, not an index
        inside.contains(|c: char| !c.is_ascii_digit()).then_some(before)
    });
    [letters(name), letters(without.unwrap_or(name))]
}

fn letters(text: &str) -> String {
    text.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
}

fn folded(name: &str) -> Vec<char> {
    name.chars().flat_map(char::to_lowercase).collect()
}

/// By how many letters two names differ, if it is at most one in three, or if one is the beginning of the other.
fn difference(one: &[char], other: &[char]) -> Option<usize> {
    let (short, long) = if one.len() < other.len() { (one, other) } else { (other, one) };
    let more = long.len() - short.len();
    if short.len() >= 3 && long.starts_with(short) {
        return Some(more);
    }
    // hardly anybody mistakes both ends; and most of thousands of names are passed over quickly
    let same_end = one.first() == other.first() || one.last() == other.last();
    let limit = long.len() / 3;
    if more > limit || !same_end {
        return None;
    }
    Some(edits(one, other)).filter(|&edits| edits <= limit)
}

/// Letters that are to be changed, added, removed, or exchanged with their neighbor to make `other` of `one` (the optimal
/// string alignment distance).
fn edits(one: &[char], other: &[char]) -> usize {
    let mut before: Vec<usize> = Vec::new();
    let mut last: Vec<usize> = (0..=other.len()).collect();
    for i in 1..=one.len() {
        let mut row = vec![i];
        for j in 1..=other.len() {
            let changed = last[j - 1] + usize::from(one[i - 1] != other[j - 1]);
            let mut least = changed.min(last[j] + 1).min(row[j - 1] + 1);
            if i > 1 && j > 1 && one[i - 1] == other[j - 2] && one[i - 2] == other[j - 1] {
                least = least.min(before[j - 2] + 1);
            }
            row.push(least);
        }
        before = std::mem::replace(&mut last, row);
    }
    last[other.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_that_is_that_of_another_column_but_for_its_spelling_is_out_of_order() {
        let columns = ["angle", "speed", "x[0]", "x[1]"];
        for (names, expected) in [
            (["angle", "speed", "x[0]", "x[1]"], None),
            (["Angle", "SPEED [rad/s]", "x_0", "X1"], None),
            (["a", "b", "c", "d"], None),
            (["Speed", "Angle", "x_0", "x_1"], Some([0, 1])),
            (["a", "b", "x_1", "x_0"], Some([2, 3])),
            (["a", "angle (rad)", "c", "d"], Some([1, 0])),
            // nothing is left of them
            (["[0]", "-", "+", "*"], None),
        ] {
            assert_eq!(out_of_order(&columns, &names), expected, "{names:?}");
        }
        // what is spelled as its own column is in its place, whatever else is spelled so
        assert_eq!(out_of_order(&["x1", "x_1"], &["X1", "x 1"]), None);
    }

    #[test]
    fn what_is_close_is_found_and_nothing_else() {
        let known =
            ["stop", "step", "learning_rate", "theta", "thetad", "L", "m", "Dämpfung", "training", "der(x)", "x[0]"];
        for (found, expected) in [
            ("stp", Some("stop")),
            ("stpe", Some("step")),
            ("STEP", Some("step")),
            ("learnign_rate", Some("learning_rate")),
            ("learning-rate", Some("learning_rate")),
            ("lerning_rate", Some("learning_rate")),
            ("thetadd", Some("thetad")),
            ("train", Some("training")),
            ("l", Some("L")),
            ("DÄMPFUNG", Some("Dämpfung")),
            ("Daempfung", Some("Dämpfung")),
            ("n", None),
            ("length", None),
            ("", None),
            ("omega", None),
            ("L [m]", Some("L")),
            ("x_0", Some("x[0]")),
        ] {
            assert_eq!(closest(found, known), expected, "{found}");
        }
        assert!(
            is_respelled("Run", "run") && is_respelled("speed [rad/s]", "Speed") && !is_respelled("der(x)", "der(y)")
        );
        assert_eq!(did_you_mean("stepp", known), "; did you mean `step`?");
        assert_eq!(did_you_mean("x", known), "");
    }

    #[test]
    fn all_missing_names_are_one_message_with_the_closest_unused_ones() {
        let known = ["time", "l", "Speed", "x[0]", "c"];
        let found = NameMatch::of(&["L", "speed", "x_0", "c"], &known);
        assert_eq!((found.positions, found.unused), (vec![None, None, None, Some(4)], vec![0, 1, 2, 3]));
        let unused = &known[..4];
        assert_eq!(missing("column", &[], &known, unused), None);
        assert_eq!(
            missing("column", &["L"], &known, unused).unwrap(),
            "no column `L`, expected it among time, l, Speed, x[0], c; did you mean `l`?"
        );
        assert_eq!(
            missing("column", &["L", "mass", "x_0"], &known, unused).unwrap(),
            "no columns `L`, `mass`, `x_0`, expected them among time, l, Speed, x[0], c; did you mean `l` for `L`, `x[0]` for `x_0`?"
        );
        // `c` has a use
        assert_eq!(missing("input", &["C"], &["c"], &[]).unwrap(), "no input `C`, expected it among c");
        assert_eq!(missing("column", &["a"], &[], &[]).unwrap(), "no column `a`, expected it among none");
    }

    #[test]
    fn long_lists_are_cut() {
        let names: Vec<String> = (0..25).map(|i| i.to_string()).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        assert_eq!(listed(&names[..3]), "0, 1, 2");
        assert!(listed(&names).ends_with("18, 19 and 5 more"));
        assert_eq!(expected_one_of("x", &[]), "there are none");
        assert_eq!(expected_one_of("stpe", &["stop", "step"]), "expected one of stop, step; did you mean `step`?");
    }
}
