// Looks at the pages of `report --html` in a real Chromium.
//
//   npm install --prefix DIR playwright-core@1.65.1
//   NODE_PATH=DIR/node_modules node tests/browser/report.cjs --binary BINARY [--require] [--screenshots DIR]
//
// Without a Chromium it says so and checks nothing; with --require that is a failure.
'use strict';
const assert = require('node:assert/strict');
const { execFileSync } = require('node:child_process');
const fs = require('node:fs');
const os = require('node:os');
const path = require('node:path');
const { parseArgs } = require('node:util');

const { values: options } = parseArgs({
  options: { binary: { type: 'string' }, require: { type: 'boolean' }, screenshots: { type: 'string' } },
});
const { CHROMIUM, ARGUMENTS, outside, readable } = require('./common.cjs');
// Names and values that would run a script, load a picture or break out of an element if they were not escaped.
const HOSTILE_NAME = '<!--<script><img src=x onerror="hacked=1">&\'"';
const HOSTILE_VALUE = '</script><script>hacked=1</script></title></style><!--{{script}}';
const directory = fs.mkdtempSync(path.join(os.tmpdir(), 'report-'));

function run(...command) {
  return execFileSync(path.resolve(options.binary), command, { cwd: directory, encoding: 'utf8' });
}

// The pages: name -> what they must show.
function makePages() {
  const small = ['evaluation.every_steps=250', 'evaluation.episodes=5', 'budget.steps=3000'].flatMap(s => ['--set', s]);
  run('train', '--quiet', '--out', 'default');
  run('train', '--quiet', '--out', 'one', '--seed', '1', ...small);
  run('train', '--quiet', '--out', HOSTILE_NAME, '--seed', '2', ...small);
  const file = path.join(directory, HOSTILE_NAME, 'config.json');
  const config = JSON.parse(fs.readFileSync(file));
  fs.writeFileSync(file, JSON.stringify({ ...config, loss: HOSTILE_VALUE, [HOSTILE_VALUE]: HOSTILE_NAME }));
  run('study', '--quiet', '--out', 'study', '--seeds', '0..10', '--vary', 'double=false,true', ...small);
  const manifest = path.join(directory, 'study', 'study.json');
  const trials = path.join(directory, 'study', 'trials');
  const study = JSON.parse(fs.readFileSync(manifest));
  const second = study.configs[1].name;
  study.configs[1].name = HOSTILE_VALUE;
  fs.writeFileSync(manifest, JSON.stringify(study));
  for (const name of fs.readdirSync(trials)) {
    const lines = fs.readFileSync(path.join(trials, name), 'utf8').trimEnd().split('\n');
    const named = lines.map((line) => line.replace(JSON.stringify(second), JSON.stringify(HOSTILE_VALUE)));
    fs.writeFileSync(path.join(trials, name), named.join('\n') + '\n');
  }
  run('report', 'default', '--html', 'default.html');
  run('report', 'one', HOSTILE_NAME, '--html', 'runs.html');
  run('report', 'study', '--html', 'study.html');
  assert(fs.statSync(path.join(directory, 'default.html')).size < 1e6, 'the page of a default run has 1 MB');
  return [
    { name: 'default', plots: 7, policy: true },
    { name: 'runs', plots: 7, policy: true, text: [HOSTILE_NAME, HOSTILE_VALUE] },
    { name: 'study', plots: 4, policy: false, text: [HOSTILE_VALUE] },
  ];
}

// The curves that can be seen: how much of the window each spans, and its points.
const curves = () => [...document.querySelectorAll('figure.plot div path[fill="none"][stroke-width]')]
  .map(element => ({ width: element.getBoundingClientRect().width / innerWidth, points: element.getAttribute('d').split('L').length }))
  .filter(({ width }) => width > 0);

const pixels = id => {
  const canvas = document.getElementById(id);
  const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
  return new Set(new Uint32Array(data.buffer)).size;
};

async function checkPolicy(page) {
  const picture = () => page.evaluate(() => document.getElementById('scene').toDataURL());
  const step = async () => Number((await page.textContent('#readout')).match(/^step (\d+) of \d+/)[1]);
  assert(await page.evaluate(pixels, 'scene') >= 4, 'nothing is drawn of the environment');
  assert(await page.evaluate(pixels, 'map') > 100, 'the map is empty');
  assert.equal(await step(), 0);
  const still = await picture();
  await page.waitForTimeout(200);
  assert.equal(await picture(), still, 'moves before it is told to');

  await page.click('#play');
  await page.waitForFunction(() => Number(document.getElementById('scrub').value) >= 5);
  const moving = await picture();
  assert.notEqual(moving, still, 'does not move');
  await page.waitForFunction(before => Number(document.getElementById('scrub').value) > before, await step());
  await page.click('#play');
  const paused = [await step(), await picture()];
  await page.waitForTimeout(200);
  assert.deepEqual([await step(), await picture()], paused, 'moves while it is paused');

  await page.locator('#scrub').focus();
  await page.keyboard.press('End');
  assert.match(await page.textContent('#readout'), /the end: return −?\d+/);
  assert.notEqual(await picture(), paused[1], 'does not follow the scrub bar');
  await page.keyboard.press('Home');
  assert.equal(await picture(), still);

  await page.locator('#map').hover({ position: { x: 120, y: 60 } });
  assert.match(await page.textContent('#value'), /°\/s: (left|right) is best, action gap \d/);
}

async function check(page, { name, plots, policy, text = [] }, { width, scheme }) {
  const problems = [];
  page.on('console', message => message.type() === 'error' && problems.push(message.text()));
  page.on('pageerror', error => problems.push(String(error)));
  page.on('dialog', dialog => problems.push(`a dialog: ${dialog.message()}`));
  page.on('request', request => request.url().startsWith('file:///') || problems.push(`asks for ${request.url()}`));
  await page.setViewportSize({ width, height: 800 });
  await page.emulateMedia({ colorScheme: scheme });
  const file = path.join(directory, `${name}.html`);
  await page.goto(`file://${file}`);
  if (options.screenshots) {
    fs.mkdirSync(options.screenshots, { recursive: true });
    await page.screenshot({ path: path.join(options.screenshots, `${name}-${scheme}-${width}.png`), fullPage: true });
  }

  assert(await page.locator('figure.plot').count() >= plots, 'plots are missing');
  // The widest: a curve over episodes ends with the last episode that did.
  const [curve] = (await page.evaluate(curves)).sort((a, b) => b.width - a.width);
  assert(curve && curve.width > 0.5 && curve.points >= 10, `no learning curve: ${JSON.stringify(curve)}`);
  assert.equal(await page.locator('#policy').count(), policy ? 1 : 0);
  if (policy) await checkPolicy(page);
  for (const hostile of text) {
    assert((await page.textContent('main')).includes(hostile), `${hostile} is not shown as it is`);
  }
  assert.equal(await page.evaluate(() => window.hacked), undefined, 'a name ran as a script');

  await page.evaluate(() => document.querySelectorAll('details').forEach(details => { details.open = true; }));
  assert.deepEqual(await page.evaluate(outside), [], 'outside of the layout');
  assert(await page.evaluate(() => document.documentElement.scrollWidth <= innerWidth), 'the page scrolls sideways');
  for (const selector of ['h1, h2, p, td, summary, output', 'figure.plot text']) {
    const { count, contrast, paper } = await page.evaluate(readable, selector);
    assert(count > 10 && contrast >= 4.5, `${selector}: contrast ${contrast} of ${count}`);
    assert.equal(paper < 0.5, scheme === 'dark', 'does not follow the colour scheme');
  }
  const size = await page.evaluate(() => Math.min(...[...document.querySelectorAll('figure.plot text')]
    .map(text => text.getBoundingClientRect().height).filter(height => height > 0)));
  assert(size >= 11, `the plots' text is ${size} px high`);
  assert.deepEqual(problems, []);
}

async function main() {
  if (!fs.existsSync(CHROMIUM)) {
    console.log(`NOT CHECKED: no Chromium at ${CHROMIUM}; install Debian's chromium, or set CHROMIUM to its path`);
    return options.require ? 1 : 0;
  }
  const { chromium } = require('playwright-core');
  const pages = makePages();
  const profile = path.join(directory, 'profile');
  const browser = await chromium.launchPersistentContext(profile, { executablePath: CHROMIUM, args: ARGUMENTS });
  try {
    for (const page of pages) {
      for (const view of [{ width: 1200, scheme: 'light' }, { width: 1200, scheme: 'dark' }, { width: 360, scheme: 'light' }]) {
        const tab = await browser.newPage();
        await check(tab, page, view);
        await tab.close();
        console.log(`${page.name}: ${view.width} px, ${view.scheme}: ok`);
      }
    }
  } finally {
    await browser.close();
    fs.rmSync(directory, { recursive: true, force: true });
  }
  return 0;
}

main().then(code => process.exit(code), error => {
  console.error(`FAILED: ${error.stack}`);
  process.exit(1);
});
