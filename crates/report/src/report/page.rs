//! The page: sections, figures and tables in one file that loads nothing.

use super::{
    Drawn, Material, ReportBlock,
    figures::{sections, sentence},
    first::first_screen,
};
use crate::{
    Result,
    html::{LOOK, escape},
};
use rayon::prelude::*;
use std::fmt::Write;

const STYLE: &str = include_str!("page.css");
/// Moves the mechanism and adds keys; the page is complete without it.
const SCRIPT: &str = include_str!("page.js");

/// The report's page and its figures. The same material always gives the same text.
///
/// # Errors
/// [`Error::Plot`](crate::Error::Plot).
pub fn page(material: &Material) -> Result<(String, Vec<Drawn>)> {
    let sections = sections(material);
    let name = escape(&material.study.name);
    let mut page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head><meta charset=\"utf-8\"><title>{name}: report</title>\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<link rel=\"icon\" href=\"data:,\">\n\
         <style>\n{LOOK}{STYLE}</style></head>\n<body>\n{}<nav>",
        first_screen(material, &sentence(material))
    );
    // writing to a string does not fail
    for section in &sections {
        let _ = write!(page, "<a href=\"#{}\">{}</a>", section.id, escape(&section.title));
    }
    page.push_str("</nav>\n");
    let mut drawn = Vec::new();
    for section in &sections {
        let _ = writeln!(page, "<section id=\"{}\">\n<h2>{}</h2>", section.id, escape(&section.title));
        for block in &section.blocks {
            match block {
                ReportBlock::Html(html) => {
                    let _ = writeln!(page, "{html}");
                }
                ReportBlock::Figures(figures) if figures.is_empty() => {}
                ReportBlock::Figures(figures) => {
                    let figures = figures.par_iter().map(|figure| figure.draw()).collect::<Result<Vec<Drawn>>>()?;
                    page.push_str("<div class=\"figures\">\n");
                    for Drawn { id, caption, svg } in &figures {
                        let caption = escape(caption);
                        let _ =
                            writeln!(page, "<figure id=\"{id}\">\n{svg}<figcaption>{caption}</figcaption></figure>");
                    }
                    page.push_str("</div>\n");
                    drawn.extend(figures);
                }
            }
        }
        page.push_str("</section>\n");
    }
    let _ = write!(page, "<script>\n{SCRIPT}</script>\n</body>\n</html>\n");
    Ok((page, drawn))
}
