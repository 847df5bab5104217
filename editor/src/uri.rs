//! Addresses of files: `file:///a%20b` on the wire, paths here.

use std::path::{Path, PathBuf};
use std::str::FromStr as _;

use lsp_types::Uri;

/// The path of an address; of something that is no file, such as a text that was never saved, the address itself.
pub(crate) fn path(uri: &Uri) -> PathBuf {
    let Some(encoded) = uri.as_str().strip_prefix("file://") else { return PathBuf::from(uri.as_str()) };
    let encoded = &encoded[encoded.find('/').unwrap_or(encoded.len())..];
    let mut bytes = Vec::with_capacity(encoded.len());
    let mut rest = encoded.as_bytes();
    while let Some((byte, after)) = rest.split_first() {
        let number = after.get(..2).and_then(|digits| std::str::from_utf8(digits).ok());
        match number.and_then(|digits| u8::from_str_radix(digits, 16).ok()) {
            Some(number) if *byte == b'%' => {
                bytes.push(number);
                rest = &after[2..];
            }
            _ => {
                bytes.push(*byte);
                rest = after;
            }
        }
    }
    let text = String::from_utf8_lossy(&bytes).into_owned();
    // `/c:/a` is a path of Windows with a slash before it.
    let drive = text.as_bytes().get(2) == Some(&b':') && cfg!(windows);
    PathBuf::from(if drive { &text[1..] } else { &text })
}

/// The address of a path.
pub(crate) fn of(path: &Path) -> Option<Uri> {
    if let Some(uri) = path.to_str().filter(|text| text.contains(':') && !path.is_absolute()) {
        return Uri::from_str(uri).ok();
    }
    let mut text = String::from("file://");
    let path = path.to_str()?.replace('\\', "/");
    if !path.starts_with('/') {
        text.push('/');
    }
    for byte in path.bytes() {
        if byte.is_ascii_alphanumeric() || b"-._~/".contains(&byte) {
            text.push(char::from(byte));
        } else {
            text.push_str(&format!("%{byte:02X}"));
        }
    }
    Uri::from_str(&text).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_survive_the_wire() {
        for given in ["/a/b.yaml", "/a b/ü 😀/100%.yaml", "/x:y"] {
            let uri = of(Path::new(given)).expect("it is an address");
            assert_eq!(path(&uri), Path::new(given), "{}", uri.as_str());
        }
        let other = Uri::from_str("file:///c%3A/a").expect("it is an address");
        assert_eq!(path(&other), Path::new("/c:/a"));
        let unsaved = Uri::from_str("untitled:Untitled-1").expect("it is an address");
        assert_eq!(path(&unsaved), Path::new("untitled:Untitled-1"));
        assert_eq!(of(&path(&unsaved)), Some(unsaved));
    }
}
