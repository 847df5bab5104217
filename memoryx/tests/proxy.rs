//! A TCP proxy between two sessions of a test or a benchmark, which can be paused or cut, and counts its bytes.

#![allow(clippy::unwrap_used, reason = "a test may fail")]
#![allow(dead_code, reason = "nobody uses all of it")]

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::sync::watch;

/// The proxy's behaviour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ProxyState {
    /// Forwards all data.
    Open,
    /// Reads nothing and loses nothing.
    Held,
    /// Closes the connection.
    Cut,
}

/// A proxy to an endpoint `tcp/...`. Returns its own endpoint, and the switch of its behaviour. Its buffers are
/// small, so that a sender soon notices a pause.
pub(crate) async fn proxy(to: &str) -> (String, watch::Sender<ProxyState>) {
    let (sender, state) = watch::channel(ProxyState::Open);
    (start(to, state, Arc::default()).await, sender)
}

/// A proxy that counts the bytes to the endpoint and from it.
pub(crate) async fn counting_proxy(to: &str) -> (String, Arc<[AtomicU64; 2]>) {
    let bytes: Arc<[AtomicU64; 2]> = Arc::default();
    let (sender, state) = watch::channel(ProxyState::Open);
    let endpoint = start(to, state, Arc::clone(&bytes)).await;
    // The proxy lives as long as the test.
    std::mem::forget(sender);
    (endpoint, bytes)
}

async fn start(to: &str, state: watch::Receiver<ProxyState>, bytes: Arc<[AtomicU64; 2]>) -> String {
    let to: SocketAddr = to.strip_prefix("tcp/").unwrap().parse().unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let endpoint = format!("tcp/{}", listener.local_addr().unwrap());
    tokio::spawn(async move {
        while let Ok((near, _)) = listener.accept().await {
            tokio::spawn(connect(near, to, state.clone(), Arc::clone(&bytes)));
        }
    });
    endpoint
}

async fn connect(
    near: TcpStream,
    to: SocketAddr,
    state: watch::Receiver<ProxyState>,
    bytes: Arc<[AtomicU64; 2]>,
) {
    if *state.borrow() == ProxyState::Cut {
        return;
    }
    let socket = TcpSocket::new_v4().unwrap();
    socket.set_recv_buffer_size(1 << 16).unwrap();
    let Ok(far) = socket.connect(to).await else { return };
    for end in [&near, &far] {
        end.set_nodelay(true).unwrap();
    }
    let ((from_near, to_near), (from_far, to_far)) = (near.into_split(), far.into_split());
    let mut is_cut = state.clone();
    tokio::select! {
        biased;
        _ = is_cut.wait_for(|state| *state == ProxyState::Cut) => {}
        () = pass(from_near, to_far, state.clone(), &bytes[0]) => {}
        () = pass(from_far, to_near, state.clone(), &bytes[1]) => {}
    }
}

async fn pass(
    mut from: OwnedReadHalf,
    mut to: OwnedWriteHalf,
    mut state: watch::Receiver<ProxyState>,
    bytes: &AtomicU64,
) {
    let mut buffer = vec![0; 1 << 14];
    while let Ok(read @ 1..) = from.read(&mut buffer).await {
        bytes.fetch_add(read as u64, Ordering::Relaxed);
        if state.wait_for(|state| *state == ProxyState::Open).await.is_err()
            || to.write_all(&buffer[..read]).await.is_err()
        {
            return;
        }
    }
}
