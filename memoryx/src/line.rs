//! A line between two sessions of a test, which can be held up or cut.

use std::net::SocketAddr;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::sync::watch;

/// What a line does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Line {
    /// Passes on what comes.
    Open,
    /// Takes nothing and loses nothing.
    Held,
    /// Is no line.
    Cut,
}

/// A line to an endpoint `tcp/...`: its own endpoint, and what says what it does. It remembers little, so that who sends soon
/// feels that it is held.
pub(crate) async fn line(to: &str) -> (String, watch::Sender<Line>) {
    let to: SocketAddr = to.strip_prefix("tcp/").unwrap().parse().unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let endpoint = format!("tcp/{}", listener.local_addr().unwrap());
    let (sender, state) = watch::channel(Line::Open);
    tokio::spawn(async move {
        while let Ok((near, _)) = listener.accept().await {
            tokio::spawn(connect(near, to, state.clone()));
        }
    });
    (endpoint, sender)
}

async fn connect(near: TcpStream, to: SocketAddr, state: watch::Receiver<Line>) {
    if *state.borrow() == Line::Cut {
        return;
    }
    let socket = TcpSocket::new_v4().unwrap();
    socket.set_recv_buffer_size(1 << 16).unwrap();
    let Ok(far) = socket.connect(to).await else { return };
    let ((from_near, to_near), (from_far, to_far)) = (near.into_split(), far.into_split());
    let mut is_cut = state.clone();
    tokio::select! {
        biased;
        _ = is_cut.wait_for(|state| *state == Line::Cut) => {}
        () = pass(from_near, to_far, state.clone()) => {}
        () = pass(from_far, to_near, state.clone()) => {}
    }
}

async fn pass(mut from: OwnedReadHalf, mut to: OwnedWriteHalf, mut state: watch::Receiver<Line>) {
    let mut buffer = vec![0; 1 << 14];
    while let Ok(read @ 1..) = from.read(&mut buffer).await {
        if state.wait_for(|state| *state == Line::Open).await.is_err()
            || to.write_all(&buffer[..read]).await.is_err()
        {
            return;
        }
    }
}
