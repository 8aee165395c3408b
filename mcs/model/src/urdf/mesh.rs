//! The points of a mesh: STL, binary or of text, and Wavefront OBJ. What is between them is taken to be convex.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;

/// What a file of STL has before its facets, and for each of them, bytes.
const HEADER: usize = 84;
const FACET: usize = 50;

/// A mesh that a file names.
#[derive(Debug, Clone)]
pub(super) struct MeshText<'a> {
    pub file: &'a str,
    pub scale: Vector3<f64>,
}

/// Why a mesh has no points, in words that its place goes before.
pub(super) enum Fault {
    /// The file is not here, or of a kind that is not read.
    NotRead(String),
    /// It is wrong.
    Wrong(String),
}

impl MeshText<'_> {
    /// The points of the mesh in m, and how many bytes its file has, of `most` that it may have. `beside` is the file that
    /// names it.
    pub fn points(&self, beside: &Path, most: u64) -> Result<(Vec<Vector3<f64>>, u64), Fault> {
        let name = self.file;
        let kind = Path::new(name).extension().unwrap_or_default();
        let is_stl = kind.eq_ignore_ascii_case("stl");
        if !is_stl && !kind.eq_ignore_ascii_case("obj") {
            return Err(Fault::NotRead(format!("`{name}` is neither STL nor OBJ")));
        }
        let not_here = |error| Fault::NotRead(format!("cannot read `{name}`: {error}"));
        let Some(path) = found(name, beside) else {
            return Err(Fault::NotRead(format!(
                "`{name}` is not found beside the URDF nor in a package above it"
            )));
        };
        let about = std::fs::metadata(&path).map_err(not_here)?;
        if about.len() > most {
            let text = format!(
                "has {} bytes, and {most} are left of what all meshes of an arm may have: simplify it",
                about.len()
            );
            return Err(Fault::Wrong(text));
        }
        let bytes = std::fs::read(&path).map_err(not_here)?;
        let points = match is_stl {
            true => stl(&bytes),
            false => obj(&bytes),
        };
        let mut points = points.map_err(Fault::Wrong)?;
        for point in &mut points {
            point.component_mul_assign(&self.scale);
        }
        // Facets share their corners.
        let key = |point: &Vector3<f64>| [point.x, point.y, point.z].map(f64::to_bits);
        points.sort_unstable_by_key(key);
        points.dedup();
        match points.is_empty() {
            true => Err(Fault::Wrong("has no facets".to_owned())),
            false => Ok((points, about.len())),
        }
    }
}

/// The file of that name: in a package, which is a folder above `beside` or in one of those, or relative to `beside`.
fn found(name: &str, beside: &Path) -> Option<PathBuf> {
    let is_file = |path: &PathBuf| path.is_file();
    let Some(inside) = name.strip_prefix("package://") else {
        let name = name.strip_prefix("file://").unwrap_or(name);
        let folder = beside.parent().unwrap_or(Path::new(""));
        return Some(folder.join(name)).filter(is_file);
    };
    let (package, rest) = inside.split_once('/')?;
    let above = std::path::absolute(beside).ok()?;
    above.ancestors().skip(1).find_map(|folder| {
        let own = folder.file_name().is_some_and(|name| name == package);
        let own = own.then(|| folder.join(rest)).filter(is_file);
        own.or_else(|| Some(folder.join(inside)).filter(is_file))
    })
}

type Points = Result<Vec<Vector3<f64>>, String>;

/// The corners of the facets of an STL.
fn stl(bytes: &[u8]) -> Points {
    let count = bytes
        .get(80..HEADER)
        .and_then(|count| count.try_into().ok());
    let facets = count.map(u32::from_le_bytes).map(|count| count as usize);
    let whole = facets.and_then(|facets| facets.checked_mul(FACET)?.checked_add(HEADER));
    if whole == Some(bytes.len()) {
        return binary_stl(bytes);
    }
    if bytes.starts_with(b"solid") {
        return text_stl(bytes);
    }
    Err(match (facets, whole) {
        (Some(facets), Some(whole)) => {
            let length = bytes.len();
            format!("says that it has {facets} facets, which are {whole} bytes, and has {length}")
        }
        _ => "is no STL: it has neither `solid` nor a count of facets".to_owned(),
    })
}

fn binary_stl(bytes: &[u8]) -> Points {
    let mut points = Vec::new();
    let (facets, _) = bytes[HEADER..].as_chunks::<FACET>();
    for (facet, number) in facets.iter().zip(1..) {
        // The normal comes first, the attribute last.
        let (numbers, _) = facet[12..48].as_chunks::<4>();
        let mut numbers = numbers
            .iter()
            .map(|number| f64::from(f32::from_le_bytes(*number)));
        while let (Some(x), Some(y), Some(z)) = (numbers.next(), numbers.next(), numbers.next()) {
            let point = Vector3::new(x, y, z);
            if !point.iter().all(|number| number.is_finite()) {
                return Err(format!("facet {number}: a corner is not finite"));
            }
            points.push(point);
        }
    }
    Ok(points)
}

fn text_of(bytes: &[u8]) -> Result<&str, String> {
    std::str::from_utf8(bytes)
        .map_err(|error| format!("is no text from byte {} on", error.valid_up_to()))
}

/// Three finite numbers, and what comes after them is the caller's.
fn three<'t>(
    words: &mut impl Iterator<Item = &'t str>,
    line: usize,
) -> Result<Vector3<f64>, String> {
    let mut next = || {
        let word = words.next().unwrap_or_default();
        let number = word.parse().ok().filter(|number: &f64| number.is_finite());
        number.ok_or_else(|| format!("line {line}: not a number: `{word}`"))
    };
    Ok(Vector3::new(next()?, next()?, next()?))
}

fn text_stl(bytes: &[u8]) -> Points {
    let (mut points, mut corners, mut ended) = (Vec::new(), 0, false);
    for (text, line) in text_of(bytes)?.lines().zip(1..) {
        let mut words = text.split_ascii_whitespace();
        let was = std::mem::take(&mut ended);
        match words.next() {
            Some("vertex") => {
                points.push(three(&mut words, line)?);
                corners += 1;
            }
            Some("endloop") if std::mem::take(&mut corners) != 3 => {
                return Err(format!("line {line}: a facet has three corners"));
            }
            Some("endsolid") => ended = true,
            Some("solid" | "facet" | "outer" | "endloop" | "endfacet") => {}
            None => ended = was,
            Some(word) => return Err(format!("line {line}: `{word}` is no word of an STL")),
        }
    }
    match ended && corners == 0 {
        true => Ok(points),
        false => Err("ends before its `endsolid`".to_owned()),
    }
}

/// The corners of the faces of an OBJ.
fn obj(bytes: &[u8]) -> Points {
    let (mut all, mut points) = (Vec::new(), Vec::new());
    for (text, line) in text_of(bytes)?.lines().zip(1..) {
        let mut words = text.split_ascii_whitespace();
        match words.next() {
            Some("v") => all.push(three(&mut words, line)?),
            Some("f") => {
                for word in words {
                    // Counted from 1, or backwards from the last one; after slashes come texture and normal.
                    let number = word.split('/').next().unwrap_or_default();
                    let index = match number.parse::<i64>() {
                        Ok(index) if index > 0 => usize::try_from(index - 1).ok(),
                        Ok(index) if index < 0 => {
                            let back = usize::try_from(index.unsigned_abs()).ok();
                            back.and_then(|back| all.len().checked_sub(back))
                        }
                        _ => None,
                    };
                    let corner = index.and_then(|index| all.get(index)).copied();
                    let missing = || format!("line {line}: there is no corner `{word}`");
                    points.push(corner.ok_or_else(missing)?);
                }
            }
            _ => {}
        }
    }
    Ok(points)
}

#[cfg(test)]
mod tests;
