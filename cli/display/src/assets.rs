//! The page's files, which are part of the program, and the page as one file with a run in it.

/// A file of the page: its name, its type, its text.
pub(crate) type Asset = (&'static str, &'static str, &'static str);

const HTML: &str = include_str!("page/index.html");
const STYLE: &str = include_str!("page/style.css");

const SCRIPT: &str = "text/javascript; charset=utf-8";

/// The scripts, each after those that it imports.
const SCRIPTS: [Asset; 27] = [
    ("model.js", SCRIPT, include_str!("page/model.js")),
    ("field.js", SCRIPT, include_str!("page/field.js")),
    ("shapes.js", SCRIPT, include_str!("page/shapes.js")),
    ("minimap.js", SCRIPT, include_str!("page/minimap.js")),
    ("view.js", SCRIPT, include_str!("page/view.js")),
    ("draw.js", SCRIPT, include_str!("page/draw.js")),
    ("fold.js", SCRIPT, include_str!("page/fold.js")),
    ("why.js", SCRIPT, include_str!("page/why.js")),
    ("task.js", SCRIPT, include_str!("page/task.js")),
    ("panels.js", SCRIPT, include_str!("page/panels.js")),
    ("loads.js", SCRIPT, include_str!("page/loads.js")),
    ("standing.js", SCRIPT, include_str!("page/standing.js")),
    ("tables.js", SCRIPT, include_str!("page/tables.js")),
    ("cell.js", SCRIPT, include_str!("page/cell.js")),
    ("solids.js", SCRIPT, include_str!("page/solids.js")),
    ("sight.js", SCRIPT, include_str!("page/sight.js")),
    ("scene.js", SCRIPT, include_str!("page/scene.js")),
    ("handles.js", SCRIPT, include_str!("page/handles.js")),
    ("plans.js", SCRIPT, include_str!("page/plans.js")),
    ("overview.js", SCRIPT, include_str!("page/overview.js")),
    ("plots.js", SCRIPT, include_str!("page/plots.js")),
    ("summary.js", SCRIPT, include_str!("page/summary.js")),
    ("panes.js", SCRIPT, include_str!("page/panes.js")),
    ("keys.js", SCRIPT, include_str!("page/keys.js")),
    ("moments.js", SCRIPT, include_str!("page/moments.js")),
    ("attention.js", SCRIPT, include_str!("page/attention.js")),
    ("app.js", SCRIPT, include_str!("page/app.js")),
];

/// The file of that name.
pub(crate) fn asset(name: &str) -> Option<Asset> {
    match name {
        "" | "index.html" => Some(("index.html", "text/html; charset=utf-8", HTML)),
        "style.css" => Some(("style.css", "text/css; charset=utf-8", STYLE)),
        _ => SCRIPTS.into_iter().find(|asset| asset.0 == name),
    }
}

/// The page as one file that needs no server, with `messages`, each the JSON of one.
pub(crate) fn standalone(messages: &[String]) -> String {
    let style = format!("<style>\n{STYLE}</style>");
    let scripts: String = SCRIPTS.iter().map(|(_, _, text)| alone(text)).collect();
    // In JSON a `<` stands in strings only, where it may be written so; nothing then ends the element.
    let run = messages.join(",\n").replace('<', "\\u003c");
    // Its scripts are in it.
    let preloaded = |line: &&str| !line.starts_with("<link rel=\"modulepreload\"");
    let lines = HTML.lines().filter(preloaded);
    let html = lines
        .fold(String::new(), |all, line| all + line + "\n")
        .replace("<link rel=\"stylesheet\" href=\"style.css\">", &style)
        .replace("<script type=\"module\" src=\"app.js\"></script>\n", "");
    let (before, after) = html
        .split_once("<script id=\"run\" type=\"application/json\"></script>")
        .unwrap_or((&html, ""));
    format!(
        "{before}<script id=\"run\" type=\"application/json\">[{run}]</script>\n\
         <script type=\"module\">\n{scripts}</script>{after}"
    )
}

/// A script without its imports and exports, as all of them are one.
fn alone(text: &str) -> String {
    let lines = text.lines().filter(|line| !line.starts_with("import "));
    lines.fold(String::new(), |mut all, line| {
        all.push_str(line.strip_prefix("export ").unwrap_or(line));
        all.push('\n');
        all
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_names_no_file_that_the_program_does_not_have_and_nothing_elsewhere() {
        for quoted in HTML.split(['"', '\'']) {
            let is_file = quoted.ends_with(".js") || quoted.ends_with(".css");
            assert!(!is_file || asset(quoted).is_some(), "{quoted}");
        }
        for (name, _, text) in SCRIPTS {
            // All are asked for at once.
            assert!(
                HTML.contains(&format!("\"{name}\">")) || HTML.contains(&format!("src=\"{name}\""))
            );
            for import in text.lines().filter(|line| line.starts_with("import ")) {
                let from = import
                    .split('"')
                    .nth(1)
                    .and_then(|from| from.strip_prefix("./"));
                let from = from.and_then(asset);
                assert!(from.is_some(), "{name}: {import}");
            }
            let namespace = text.replace("http://www.w3.org/2000/svg", "");
            assert!(
                !namespace.contains("http://") && !namespace.contains("https://"),
                "{name}"
            );
        }
        assert!(asset("../args.rs").is_none() && asset("nothing.js").is_none());
    }

    #[test]
    fn scripts_that_become_one_share_no_name() {
        let mut known = std::collections::BTreeMap::new();
        for (file, _, text) in SCRIPTS {
            for line in text.lines() {
                let line = line.strip_prefix("export ").unwrap_or(line);
                let named = ["const ", "function ", "class ", "let "];
                let Some(rest) = named.iter().find_map(|word| line.strip_prefix(word)) else {
                    continue;
                };
                let end =
                    rest.find(|letter: char| !letter.is_alphanumeric() && !"_$".contains(letter));
                let end = end.unwrap_or(rest.len());
                // `const [A, B]` names nothing at this place.
                if let Some(name) = rest.get(..end).filter(|name| !name.is_empty()) {
                    let other = known.insert(name.to_owned(), file);
                    assert!(other.is_none(), "{name} is in {other:?} and in {file}");
                }
            }
        }
    }

    #[test]
    fn a_page_of_one_file_loads_nothing_and_no_text_of_a_run_ends_its_script() {
        let page = standalone(&["{\"app\":\"</script><b>\"}".to_owned()]);
        assert!(page.contains("\\u003c/script>"));
        assert!(!page.contains("src=\"") && !page.contains("href=\"style.css\""));
        assert!(!page.contains(".js\">"));
        assert!(!page.contains("\nimport ") && !page.contains("\nexport "));
        assert_eq!(page.matches("</script>").count(), 2);
    }
}
