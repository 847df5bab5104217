//! The folder of annotated images: the output file of each image. Output of an earlier call is replaced, but never an
//! input image, nor the annotated image of another input.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use armarium_visionx::{RgbImage, annotate};

use super::AnnotateArgs;

/// Where annotated images are written, if anywhere.
#[derive(Debug, Default)]
pub(super) struct Album {
    folder: Option<PathBuf>,
    /// The output files of the images that are known beforehand.
    planned: BTreeMap<PathBuf, PathBuf>,
    /// All output files assigned so far.
    taken: BTreeSet<PathBuf>,
}

impl Album {
    /// Plans the output files of these images: `NAME.png`, and `NAME_2.png` for another of the same name. None may be an input image.
    pub(super) fn of(args: &AnnotateArgs, images: &[PathBuf]) -> Result<Self, String> {
        let Some(folder) = &args.annotate else { return Ok(Self::default()) };
        if folder.exists() && !folder.is_dir() {
            return Err(format!("--annotate {}: is a file; name a folder", folder.display()));
        }
        let mut album = Self { folder: Some(folder.clone()), ..Self::default() };
        let own: BTreeSet<PathBuf> = images.iter().filter_map(|image| image.canonicalize().ok()).collect();
        for image in images {
            if album.planned.contains_key(image) {
                continue;
            }
            let stem = image.file_stem().unwrap_or_default().to_string_lossy();
            let path = album.place(folder, &stem);
            let shown = path.display();
            if path.canonicalize().is_ok_and(|path| own.contains(&path)) {
                return Err(format!(
                    "{shown}: is one of the images themselves; name another folder with --annotate"
                ));
            }
            album.planned.insert(image.clone(), path);
        }
        Ok(album)
    }

    /// An output file that no other image has.
    fn place(&mut self, folder: &Path, name: &str) -> PathBuf {
        let mut path = folder.join(format!("{name}.png"));
        let mut number = 2u64;
        while !self.taken.insert(path.clone()) {
            path = folder.join(format!("{name}_{number}.png"));
            number += 1;
        }
        path
    }

    /// Writes an annotated image, if requested: to its planned file, or for a message of a recording to one with the
    /// message's name.
    pub(super) fn keep(&mut self, name: &str, image: &RgbImage) -> Result<(), String> {
        let Some(folder) = self.folder.clone() else { return Ok(()) };
        let path = match self.planned.get(Path::new(name)) {
            Some(path) => path.clone(),
            None => {
                // A name from a recording must not name a folder.
                let plain = |c: char| if c.is_alphanumeric() || c == '.' || c == '-' { c } else { '_' };
                let name: String = name.chars().map(plain).collect();
                self.place(&folder, &name)
            }
        };
        let failed = |e: &dyn std::fmt::Display| format!("{}: {e}", path.display());
        let bytes = annotate::png(image).map_err(|e| failed(&e))?;
        fs::create_dir_all(&folder).and_then(|()| fs::write(&path, bytes)).map_err(|e| failed(&e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn into(folder: &Path) -> AnnotateArgs {
        AnnotateArgs { annotate: Some(folder.into()) }
    }

    #[test]
    fn no_image_is_replaced_and_no_annotated_one_by_another() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let at = |name: &str| folder.path().join(name);
        let image = RgbImage::from_rgb(1, 1, vec![1; 3]).expect("it has the size");
        fs::create_dir(at("other")).expect("it can be made");
        let images = [at("a.png"), at("a.jpg"), at("other/a.png")];
        images.iter().for_each(|image| fs::write(image, b"mine").expect("it can be written"));

        let same = Album::of(&into(folder.path()), &images).expect_err("the images are in it");
        assert!(same.contains("a.png: is one of the images themselves"), "{same}");
        let file = Album::of(&into(&at("a.png")), &images).expect_err("it is a file");
        assert!(file.contains("is a file; name a folder"), "{file}");

        let mut album = Album::of(&into(&at("seen")), &images).expect("there is a place for each");
        let name = |file: &Path| file.to_str().expect("it is text").to_owned();
        images.iter().for_each(|file| album.keep(&name(file), &image).expect("it can be written"));
        let names = fs::read_dir(at("seen")).expect("it is there").filter_map(Result::ok);
        let names: BTreeSet<_> = names.map(|file| file.file_name()).collect();
        assert_eq!(names, ["a.png", "a_2.png", "a_3.png"].map(Into::into).into());
        assert!(images.iter().all(|image| fs::read(image).is_ok_and(|bytes| bytes == b"mine")));

        let mut again =
            Album::of(&into(&at("seen")), &images[..1]).expect("what was seen before is replaced");
        again.keep(&name(&images[0]), &image).expect("it can be written");
        let mut frames = Album::of(&into(&at("seen")), &[]).expect("a recording has no files");
        frames.keep("../a.b@12", &image).expect("it can be written");
        assert!(at("seen/.._a.b_12.png").is_file());
        assert!(Album::default().keep("a", &image).is_ok());
    }
}
