//! `metafmu schema`: prints the JSON schema of the files that people write.

use super::{CommandOutcome, print_json};
use crate::cli::{SchemaArgs, SchemaOf};
use metafmu::{Result, import, multibody, study};

pub fn run(args: &SchemaArgs) -> Result<CommandOutcome> {
    print_json(match args.file {
        SchemaOf::Study => study::json_schema(),
        SchemaOf::Mechanism => multibody::json_schema(),
        SchemaOf::Interface => import::interface::json_schema(),
    })?;
    Ok(CommandOutcome::Fine)
}
