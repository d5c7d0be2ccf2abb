//! Variables of a description: expressions with a name.

use super::expression::Expression;
use crate::diagnostics::Problems;
use indexmap::IndexMap;

/// The variables with the variables that they name substituted, and the problems of the others.
pub fn variables(variables: &IndexMap<String, Expression>) -> (IndexMap<String, Expression>, Problems) {
    let (mut expanded, mut problems) = (IndexMap::new(), Problems::default());
    let mut left: Vec<(&String, &Expression)> = variables.iter().collect();
    while !left.is_empty() {
        let (others, ready): (Vec<_>, Vec<_>) =
            left.into_iter().partition(|(_, of)| of.names().iter().any(|name| waits(name, variables, &expanded)));
        if ready.is_empty() {
            for (name, of) in others {
                problems.add(format!("variables.{name}"), format!("`{of}` depends on the variable itself"));
            }
            break;
        }
        for (name, of) in ready {
            match of.with_variables(&expanded) {
                Ok(of) => {
                    expanded.insert(name.clone(), of);
                }
                Err(error) => {
                    problems.add(format!("variables.{name}"), error.message);
                    expanded.insert(name.clone(), Expression::default());
                }
            }
        }
        left = others;
    }
    (expanded, problems)
}

/// Returns true if a name is that of a variable that is not expanded yet.
fn waits(name: &str, variables: &IndexMap<String, Expression>, expanded: &IndexMap<String, Expression>) -> bool {
    variables.contains_key(name) && !expanded.contains_key(name)
}
