//! Who sees the images of an agent's cameras, and what its live page is told.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use armarium_bus::{Access, KeyPattern, Session, SessionConfig, keys};
use armarium_visionx::providers::{
    Delivery, FileProvider, ImageCoding, ImageProvider as _, Pace, RemoteProvider, offer,
};

use super::Authority;

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn images_and_the_live_page_are_for_watchers() {
    let folder = tempfile::tempdir().unwrap();
    let authority = Authority::new(folder.path());
    let access = Access {
        own: "lab".into(),
        watchers: vec!["walt".into()],
        readers: vec!["rita".into()],
        ..Access::default()
    };
    let lab = SessionConfig {
        listen: vec!["tls/127.0.0.1:0".into()],
        tls: Some(authority.tls("lab")),
        access_control: Some(access.rules().unwrap()),
        ..SessionConfig::default()
    };
    let lab = Session::open(&lab).await.unwrap();
    let endpoints = lab.endpoints().await;
    let photograph =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../visionx/tests/photographs/b03_open_hand.jpg");
    let pace = Pace { speed: Some(1.0), repeat: true };
    let camera = FileProvider::open("eyes", &[photograph], 20.0, pace).await.unwrap();
    let _offered = offer(&lab, "lab", Arc::new(camera)).await.unwrap();
    let page = keys::live("lab", "page").unwrap();
    let mut questions = lab.declare_queryable(page.clone(), 16).await.unwrap();
    let answered = page.clone();
    let _answering = tokio::spawn(async move {
        while let Some(question) = questions.next().await {
            question.reply(&answered, "text/plain", b"shown".to_vec()).await.unwrap();
        }
    });

    for (name, sees) in [("walt", true), ("rita", false), ("mallory", false)] {
        let config = SessionConfig {
            tls: Some(authority.tls(name)),
            listen: Vec::new(),
            ..SessionConfig::connected_to(&endpoints)
        };
        let session = Session::open(&config).await.unwrap();
        let wait = if sees { Duration::from_secs(20) } else { Duration::from_secs(1) };
        for coding in [ImageCoding::Raw, ImageCoding::Jpeg] {
            let found =
                RemoteProvider::connect(&session, "lab", "eyes", Delivery::Newest, coding, wait).await;
            assert_eq!(found.is_ok(), sees, "{name}");
            if let Ok(images) = found {
                images.next().await.unwrap();
            }
        }
        let those = KeyPattern::from(page.clone());
        let told = session.query(those, "", None, 1, wait).await.unwrap();
        assert_eq!(told.len(), usize::from(sees), "{name}");
    }
}
