const image = document.getElementById('frame'), state = document.getElementById('state');
let seen = 0, times = [];
async function next() {
  try {
    const answer = await fetch('/frame?' + seen);
    if (answer.status === 200) {
      seen = +answer.headers.get('X-Frame');
      const old = image.src;
      image.src = URL.createObjectURL(await answer.blob());
      image.hidden = false;
      if (old) URL.revokeObjectURL(old);
      times = times.concat(performance.now()).slice(-30);
      const span = (times[times.length - 1] - times[0]) / 1000;
      state.textContent = 'frame ' + seen + (span > 0 ? ', ' + ((times.length - 1) / span).toFixed(1) + ' frames/s' : '');
    } else if (answer.status === 410) {
      state.textContent = (seen ? 'frame ' + seen + ', the last: ' : '') + 'the provider has ended';
      return;
    } else {
      state.textContent = 'no new frame for ten seconds';
    }
    next();
  } catch {
    state.textContent = 'the program has ended';
    setTimeout(next, 1000);
  }
}
next();
