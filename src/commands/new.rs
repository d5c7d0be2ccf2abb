//! `metafmu new`: writes a commented study file.

use super::{Outcome, print};
use crate::cli::NewArgs;
use metafmu::{Error, Result, files, source::systems::SYSTEMS, study::Study};
use std::path::PathBuf;

pub fn run(args: &NewArgs) -> Result<Outcome> {
    let path = PathBuf::from(format!("{}.toml", args.name));
    let system = SYSTEMS.iter().find(|system| system.name == args.system);
    let template = system.map_or("", |system| system.study);
    let text = template
        .replacen(&format!("metafmu new {}", args.system), &format!("metafmu new {}", args.name), 1)
        .replacen(&format!("{}.toml", args.system), &format!("{}.toml", args.name), 1)
        .replacen(&format!("name = \"{}\"", args.system), &format!("name = \"{}\"", args.name), 1);
    Study::parse(&text, &path)?;
    if path.exists() {
        let source = std::io::Error::from(std::io::ErrorKind::AlreadyExists);
        return Err(Error::io(&path, "write")(source));
    }
    files::write_whole(&path, text.as_bytes())?;
    print(&format!("{}\nbuild it with `metafmu build {}`\n", path.display(), path.display()))?;
    Ok(Outcome::Fine)
}
