// Drives the live page in a real browser. Arguments: the folder with npm packages, the browser, a scenario, the address, a folder for pictures,
// and where the run can be stopped, if that is elsewhere.
// Prints what it found as JSON; any surprise ends it with a reason.

import { createRequire } from 'node:module';

const [modules, browserPath, scenario, url, pictures, actor = url] = process.argv.slice(2);
const require = createRequire(`${modules}/`);
const { chromium } = require('playwright-core');

const browser = await chromium.launch({ executablePath: browserPath, args: ['--no-sandbox', '--enable-unsafe-swiftshader'] });
const errors = [];
async function open(size = { width: 1366, height: 768 }, more = {}, shown = '[data-state]') {
  const context = await browser.newContext({ viewport: size, ...more });
  if (scenario === 'access') await context.addInitScript({ path: require.resolve('axe-core/axe.min.js') });
  const page = await context.newPage();
  page.on('console', (message) => { if (message.type() === 'error' && !/ERR_CONNECTION|Failed to load resource/.test(message.text())) errors.push(message.text()); });
  page.on('pageerror', (error) => errors.push(String(error)));
  await page.goto(url);
  await page.waitForSelector(shown);
  return page;
}
const active = (page) => page.$$eval('[data-state].active', (all) => all.map((each) => each.dataset.state).filter(Boolean));
const picture = (page, name) => page.screenshot({ path: `${pictures}/${name}.png` });
const expect = (holds, what) => { if (!holds) throw new Error(what); };
const badge = (page) => page.textContent('#badge');
// Stops the run: however slow a machine is, the run lasts until all has been seen that is to be seen while it goes on.
async function stop() {
  const context = await browser.newContext({ ignoreHTTPSErrors: true }), page = await context.newPage();
  await page.goto(actor);
  await page.waitForSelector('#acting button');
  await Promise.all([page.waitForResponse((answer) => answer.url().endsWith('/act')), page.click('#acting button:has-text("stop the robot")')]);
  await context.close();
}
const ended = (page) => page.waitForFunction(() => !['running', 'paused', 'not connected', '…'].includes(document.getElementById('badge').textContent), null, { timeout: 240000 });
// What a tab needs, MB, and up to where it knows the run, s.
async function heap(page) {
  const client = await page.context().newCDPSession(page);
  await client.send('HeapProfiler.collectGarbage');
  return [(await client.send('Runtime.getHeapUsage')).usedSize / 1e6, await page.evaluate(async () => (await import('/run.js')).run.now)];
}

const scenarios = {
  // To the end, with a reload in the middle and looking back.
  async follow() {
    const page = await open();
    await page.waitForFunction(() => document.querySelectorAll('[data-state].active').length > 1);
    const during = await active(page);
    await picture(page, 'overview');
    await page.reload();
    await page.waitForFunction(() => document.querySelectorAll('[data-state].active').length > 1);
    await stop();
    await ended(page);
    const outcome = await badge(page);
    await picture(page, 'ended');
    await page.keyboard.press('Home');
    await page.keyboard.press('.');
    await page.waitForFunction(() => document.getElementById('now').textContent.includes('looking back'));
    const back = await active(page);
    expect(back.length > 0, 'nothing is active at the first transition');
    for (const view of ['chart', 'world', 'time', 'memory', 'report']) { await page.click(`#tab-${view}`); await page.waitForTimeout(700); await picture(page, view); }
    await page.click('#tab-memory');
    const entities = await page.$$eval('[data-entity]', (all) => all.length);
    await page.click('#tab-overview');
    return { during, outcome, back, entities };
  },
  // Every view of a finished run at one time, on a laptop, in the dark, and on a phone.
  async views() {
    const names = [];
    const at = async (page, view, name) => {
      await page.keyboard.press('Home');
      await page.keyboard.press('.');
      await page.click(`#tab-${view}`);
      await page.waitForTimeout(1500);
      await picture(page, name); names.push(name);
    };
    const page = await open();
    for (const view of ['overview', 'chart', 'world', 'time', 'memory']) await at(page, view, view);
    const dark = await open({ width: 1366, height: 768 }, { colorScheme: 'dark' });
    await at(dark, 'overview', 'dark');
    const phone = await open({ width: 390, height: 844 }, { hasTouch: true });
    await at(phone, 'chart', 'phone');
    return names;
  },
  // Beyond this machine: the address without its token shows nothing, with it all.
  async invited() {
    const context = await browser.newContext({ ignoreHTTPSErrors: true }), stranger = await context.newPage();
    const bare = await stranger.goto(url.split('?')[0]);
    expect(bare.status() === 403 && (await bare.text()).includes('the whole address'), 'who has no token is told what to open');
    const page = await open(undefined, { ignoreHTTPSErrors: true });
    expect(!page.url().includes('token'), 'the token does not stay in the address');
    await page.waitForFunction(() => document.querySelectorAll('[data-state].active').length > 1);
    await stop();
    await ended(page);
    return { outcome: await badge(page) };
  },
  // Two hands are clicked, and one image has none.
  async label() {
    const page = await open(undefined, {}, '#ask');
    const loaded = () => page.waitForFunction(() => document.getElementById('image').complete && document.getElementById('image').naturalWidth > 0);
    const click = async (x, y) => {
      await loaded();
      const [box, size] = [await page.locator('#image').boundingBox(), await page.$eval('#image', (image) => [image.naturalWidth, image.naturalHeight])];
      await page.mouse.click(box.x + x / size[0] * box.width, box.y + y / size[1] * box.height);
    };
    const kept = (count) => page.waitForFunction((wanted) => document.getElementById('count').textContent.includes(`${wanted} labelled`), count);
    for (const place of [[260, 560], [260, 330], [214, 96]]) await click(...place);
    await page.click('#gestures button:has-text("point one")');
    await kept(1);
    await picture(page, 'label');
    await page.keyboard.press('ArrowRight');
    await page.keyboard.press('n');
    await kept(2);
    await page.reload();
    await page.waitForFunction(() => document.getElementById('count').textContent.startsWith('image 3'));
    return { count: await page.textContent('#count'), problem: await page.textContent('#problem') };
  },
  // Two runs beside each other show the same time.
  async compare() {
    const page = await open({ width: 1600, height: 900 }, {}, 'iframe');
    const frames = page.frames().filter((frame) => frame !== page.mainFrame());
    for (const frame of frames) await frame.waitForSelector('[data-state]');
    const clocks = () => Promise.all(frames.map((frame) => frame.textContent('#clock')));
    await frames[0].click('#tab-overview');
    for (const [frame, key] of [[frames[0], 'Home'], [frames[0], '.'], [frames[1], '.']]) {
      await frame.locator('body').press(key);
      await page.waitForTimeout(400);
      const [a, b] = await clocks();
      expect(a === b, `after ${key} the runs show ${a} and ${b}`);
    }
    await page.click('#differences');
    const status = await page.textContent('#status');
    await picture(page, 'compare');
    return { status, clocks: await clocks(), figures: await page.$$eval('[data-figure]', (all) => all.length) };
  },
  // A breakpoint, a step, going on; by hand.
  async act() {
    const page = await open();
    await page.waitForSelector('#acting button');
    await page.click('#acting button:has-text("pause")');
    await page.waitForFunction(() => document.getElementById('badge').textContent === 'paused');
    const before = await page.textContent('#clock');
    await page.waitForTimeout(500);
    expect(before === await page.textContent('#clock'), 'time goes on in a pause');
    const from = (await active(page)).join();
    await page.click('#acting button:has-text("step")');
    await page.waitForFunction((then) => document.getElementById('badge').textContent === 'paused'
      && [...document.querySelectorAll('[data-state].active')].map((each) => each.dataset.state).filter(Boolean).join() !== then, from, { timeout: 60000 });
    await picture(page, 'paused');
    // At the next visit of a state.
    if ((await active(page)).includes('Swing.Back')) { await page.click('#acting button:has-text("step")'); await page.waitForSelector('[data-state="Swing.There"].active'); }
    const state = page.locator('[data-state="Swing.Back"]');
    await state.focus(); await page.keyboard.press('Enter');
    await page.click('.detail button:has-text("breakpoint")');
    await page.click('#acting button:has-text("go on")');
    await page.waitForFunction(() => document.getElementById('badge').textContent === 'paused' && document.querySelector('[data-state="Swing.Back"].active'), null, { timeout: 60000 });
    const stopped = await active(page);
    await picture(page, 'breakpoint');
    await page.click('.detail button:has-text("no breakpoint")');
    // After the next transition the skill ends as somebody chooses.
    await page.click('#acting button:has-text("step")');
    await page.waitForFunction(() => document.getElementById('badge').textContent === 'paused' && document.querySelector('[data-state="Swing.There"].active'), null, { timeout: 60000 });
    await page.locator('[data-state="Swing.There"]').focus(); await page.keyboard.press('Enter');
    await page.click('.detail button:text-is("failure")');
    await picture(page, 'outcome');
    await page.click('#acting button:has-text("go on")');
    await ended(page);
    return { stopped, outcome: await badge(page), problem: await page.textContent('#problem') };
  },
  // First paint, from an event to what is shown, images of the world a second, and growth.
  async measure() {
    const page = await open({ width: 1366, height: 768 }, {}, '[data-state="Both.Flip.One"].active');
    const paint = await page.evaluate(() => performance.getEntriesByName('first-contentful-paint')[0]?.startTime);
    const flips = await page.evaluate(async () => {
      const { run, act } = await import('/run.js'), frame = () => new Promise((done) => requestAnimationFrame(done)), took = [];
      for (let k = 0; k < 40; k++) {
        const to = document.querySelector(`[data-state="Both.Flip.${k % 2 ? 'One' : 'Two'}"]`), began = performance.now();
        act({ do: 'event', name: 'flip' });
        while (!to.classList.contains('active')) await frame();
        took.push(performance.now() - began);
        await new Promise((done) => setTimeout(done, 50 + Math.random() * 100));
      }
      return took.sort((a, b) => a - b);
    });
    await page.click('#tab-world');
    const images = await page.evaluate(async () => {
      let drawn = 0; const clear = WebGLRenderingContext.prototype.clear;
      WebGLRenderingContext.prototype.clear = function (...what) { drawn += 1; return clear.apply(this, what); };
      await new Promise((done) => setTimeout(done, 5000));
      return drawn / 5;
    });
    const [before, from] = await heap(page);
    await page.waitForTimeout(60000);
    const [after, to] = await heap(page);
    return { first_paint_ms: paint, event_to_shown_ms: { median: flips[20], worst: flips[39] }, images_per_s: images, heap_mb: [before, after], run_s: to - from };
  },
  // How much a tab grows in an hour of run, after the first minute, while one view after the other is looked at.
  async hour() {
    const page = await open(), views = ['overview', 'chart', 'world', 'time', 'memory', 'report'];
    const until = async (from, s) => {
      for (let k = 0; (await heap(page))[1] < from + s; k++) { await page.click(`#tab-${views[k % 6]}`); await page.waitForTimeout(2000); }
    };
    await until(0, 60);
    const [before, from] = await heap(page);
    await until(from, 3600);
    const [after, to] = await heap(page);
    return { heap_mb: [before, after], run_s: to - from };
  },
  // Keyboard, phone, dark, what screen readers need.
  async access() {
    const page = await open();
    const axe = await page.evaluate(async () => (await window.axe.run()).violations.filter((v) => ['serious', 'critical'].includes(v.impact)).map((v) => `${v.id}: ${v.nodes.slice(0, 3).map((n) => n.target).join(' ; ')}`));
    await page.keyboard.press('2');
    expect(await page.getAttribute('#tab-chart', 'aria-selected') === 'true', 'the key 2 shows the chart');
    const state = await page.$('[data-state]:not([data-state=""])');
    await state.focus(); await page.keyboard.press('Enter');
    await page.waitForSelector('.detail h2');
    const phone = await open({ width: 390, height: 844 }, { colorScheme: 'dark', hasTouch: true });
    await phone.waitForTimeout(500);
    const wide = await phone.evaluate(() => document.documentElement.scrollWidth);
    expect(wide <= 390, `the page is ${wide} px wide on a phone`);
    await picture(phone, 'phone');
    const tabs = await Promise.all(Array.from({ length: 10 }, () => page.context().newPage()));
    for (const tab of tabs) { await tab.goto(url); await tab.waitForSelector('[data-state]'); }
    // What failed is in view: the reason, the chain, the state.
    await ended(page);
    await picture(page, 'failed');
    const problem = await page.textContent('#problem');
    const failed = await page.$$eval('[data-state].failed', (all) => all.map((each) => each.dataset.state));
    for (const tab of tabs) await ended(tab);
    return { axe, problem, failed };
  },
};
try {
  const found = await scenarios[scenario]();
  expect(errors.length === 0, `the page says: ${errors.join('; ')}`);
  console.log(JSON.stringify(found));
} catch (error) {
  console.error(String(error), errors.join('; '));
  process.exitCode = 1;
}
await browser.close();
