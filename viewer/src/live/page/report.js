// The report as far as it is known: the same parts as in report.html, drawn by the program.

import { run, listen } from '/run.js';

export function reportView(panel) {
  panel.innerHTML = `<div class="tools"><h2>Report</h2><span class="dim"></span></div><div class="fill report" tabindex="0" role="region" aria-label="The report"></div>`;
  const [note, fill] = [panel.querySelector('.dim'), panel.querySelector('.report')];
  let last = -Infinity, asking = false;
  async function draw() {
    if (panel.hidden || asking || performance.now() - last < 2000) return;
    asking = true;
    try {
      const answer = await fetch('report');
      const { scrollTop } = fill;
      fill.innerHTML = await answer.text() || '<p class="dim">Nothing to report yet.</p>';
      fill.scrollTop = scrollTop;
      note.textContent = run.ended ? '' : 'as far as it is known';
    } catch { note.textContent = 'as it was when the program ended'; }
    asking = false; last = performance.now();
  }
  window.addEventListener('resize', draw);
  listen((what) => { if (what.has('ended') || what.has('all')) last = -Infinity; draw(); });
}
