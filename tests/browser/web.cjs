// The page that trains, in a real Chromium.
//
//   npm install --prefix DIR playwright-core@1.65.1
//   MODULES=MODULES web/build.sh DIR
//   NODE_PATH=DIR/node_modules node tests/browser/web.cjs --binary BINARY --page DIR/index.html --modules MODULES
//       [--require] [--screenshots DIR]
//
// Without a Chromium it says so and checks nothing; with --require that is a failure.
'use strict';
const assert = require('node:assert/strict');
const { execFileSync } = require('node:child_process');
const fs = require('node:fs');
const os = require('node:os');
const path = require('node:path');
const { parseArgs } = require('node:util');
const { CHROMIUM, ARGUMENTS, outside, readable } = require('./common.cjs');

const { values: options } = parseArgs({
  options: {
    binary: { type: 'string' }, page: { type: 'string' }, modules: { type: 'string' }, require: { type: 'boolean' },
    screenshots: { type: 'string' },
  },
});
const directory = fs.mkdtempSync(path.join(os.tmpdir(), 'web-'));
const address = `file://${path.resolve(options.page)}`;
const problems = [];

const program = (...command) => execFileSync(path.resolve(options.binary), command, { cwd: directory, encoding: 'utf8' });

// Runs a command line as the page shows it, and returns the run's summary.
function trained(command) {
  assert.match(command, /^cartpole-dqn train /);
  fs.rmSync(path.join(directory, 'runs'), { recursive: true, force: true });
  fs.mkdirSync(path.join(directory, 'runs'));
  const line = command.replace('cartpole-dqn', `'${path.resolve(options.binary)}'`);
  execFileSync('bash', ['-c', `${line} --quiet`], { cwd: directory });
  return JSON.parse(fs.readFileSync(path.join(directory, 'runs/page/summary.json')));
}

const text = (page, id) => page.textContent(`#${id}`);
const sees = (page, id, pattern) => page.waitForFunction(
  ([id, source]) => new RegExp(source).test(document.getElementById(id).textContent), [id, pattern.source], { timeout: 120_000 });

// Waits for an expression in the page, and returns its value. The page allows no script to be made from a text, so that
// `waitForFunction` cannot do it.
async function until(page, expression) {
  const end = Date.now() + 120_000;
  for (;;) {
    const value = await page.evaluate(expression);
    if (value) return value;
    assert(Date.now() < end, `never: ${expression}`);
    await page.waitForTimeout(20);
  }
}

async function open(browser, fragment = '', { width = 1200, height = 900, scheme = 'light', motion = 'no-preference' } = {}) {
  const page = await browser.newPage();
  page.on('console', message => message.type() === 'error' && problems.push(message.text()));
  page.on('pageerror', error => problems.push(String(error)));
  page.on('request', request => /^(file|blob|data):/.test(request.url()) || problems.push(`asks for ${request.url()}`));
  await page.setViewportSize({ width, height });
  await page.emulateMedia({ colorScheme: scheme, reducedMotion: motion });
  await page.goto(address + fragment);
  await until(page, 'run.refused || run.policy');
  return page;
}

// Whether something is within the window.
const onScreen = (page, id) => page.evaluate(id => {
  const { top, bottom, height } = document.getElementById(id).getBoundingClientRect();
  return height > 0 && top >= 0 && bottom <= innerHeight;
}, id);

async function screenshot(page, name, fullPage = true) {
  if (!options.screenshots) return;
  fs.mkdirSync(options.screenshots, { recursive: true });
  await page.screenshot({ path: path.join(options.screenshots, `${name}.png`), fullPage });
}

async function saved(page, button) {
  const [download] = await Promise.all([page.waitForEvent('download'), page.click(`#${button}`)]);
  return fs.readFileSync(await download.path());
}

async function theDefaultIsSolvedWithTheProgramsBits(browser) {
  const page = await open(browser);
  assert.match(await text(page, 'story'), /knows nothing yet/);
  await sees(page, 'standing', /fell after/);
  const begin = Date.now();
  await page.click('#train');
  await until(page, 'run.evaluations.length >= 2');
  await screenshot(page, 'learning');
  await until(page, 'run.solvedSeconds !== null');
  const solved = (Date.now() - begin) / 1000;
  await sees(page, 'where', /The run has ended/);
  assert.match(await text(page, 'story'), /^Solved after [\d,]+ steps/);
  const { state, seconds, instruction } = await page.evaluate(
    '({ state: run.state, seconds: run.seconds, instruction: document.getElementById("version").textContent })');
  const summary = trained(await text(page, 'command'));
  assert.equal(await text(page, 'sha256'), summary.weights_sha256);
  assert.equal(state.env_steps, summary.env_steps);
  console.log(`solved ${solved.toFixed(1)} s after pressing Train; ${Math.round(state.updates / seconds)} updates a second `
    + `(${instruction}), the program has ${Math.round(summary.updates / summary.wall_seconds)}`);
  for (const name of ['best', 'last']) {
    const ours = await saved(page, name);
    const theirs = fs.readFileSync(path.join(directory, `runs/page/checkpoints/${name}.safetensors`));
    assert(ours.equals(theirs), `${name}.safetensors has other bytes than the program's`);
  }
  fs.copyFileSync(path.join(directory, 'runs/page/checkpoints/best.safetensors'), path.join(directory, 'best.safetensors'));
  await screenshot(page, 'desktop-light');
  await pushes(page);
  await page.close();
}

async function pushes(page) {
  await until(page, 'episode.moment.steps > 20 && !episode.moment.terminated');
  await page.keyboard.press('ArrowLeft');
  await until(page, 'episode.pushed');
  await page.click('#play');
  const still = await page.evaluate('episode.moment.steps');
  await page.waitForTimeout(200);
  assert.equal(await page.evaluate('episode.moment.steps'), still, 'moves while it is paused');
  await page.evaluate('episode.moment = player.json("reset", null, 0), episode.pause = 0');
  // A push plays one step. The policy's own push changes the velocity by 0.2 m/s, the blow by 0.5 m/s.
  for (const [action, side] of [[() => page.keyboard.press('ArrowRight'), 1], [() => page.click('#left'), -1]]) {
    const before = await page.evaluate('episode.moment.state[1]');
    await action();
    const change = await page.evaluate('episode.moment.state[1]') - before;
    assert(side * change > 0.25, `a push to ${side} changed the velocity by ${change}`);
  }
}

async function aCheckpointIsPlayed(browser) {
  const page = await open(browser);
  await page.setInputFiles('#file', path.join(directory, 'best.safetensors'));
  await sees(page, 'source', /the policy of best\.safetensors, after [\d,]+ steps/);
  await until(page, 'episode.moment.steps > 100');
  assert(await onScreen(page, 'cart'), 'the pole of the file plays where nobody sees it');
  await page.evaluate(() => scrollTo(0, document.body.scrollHeight));
  // A real drop, of what is no checkpoint.
  await page.evaluate(() => {
    const data = new DataTransfer();
    data.items.add(new File(['hello'], 'notes.txt'));
    document.getElementById('drop').dispatchEvent(new DragEvent('drop', { dataTransfer: data, bubbles: true, cancelable: true }));
  });
  await sees(page, 'problem', /notes\.txt cannot be played/);
  assert(await onScreen(page, 'problem'), 'the message is where nobody sees it');
  assert.match(await text(page, 'source'), /best\.safetensors/);
  await page.click('#close');
  assert(await page.isHidden('#message'));
  await page.click('#current');
  await sees(page, 'source', /as it is now, after 0 steps/);
  await page.close();
}

async function aChangedRunIsTheOneOfItsCommand(browser) {
  const page = await open(browser, '#preset=plain&seed=3&budget.steps=6000');
  await page.click('text=Target network');
  await page.click('text=Replay memory');
  await page.locator('#slider-learning_rate').focus();
  await page.keyboard.press('End');
  await sees(page, 'command', /learning_rate=0\.3/);
  const command = await text(page, 'command');
  assert.match(command, /--config plain --seed 3 --set budget\.steps=6000 --set target\.kind=none --set replay\.capacity=32/);
  await page.reload();
  await sees(page, 'source', /Plays/);
  assert.equal(await text(page, 'command'), command, 'the link does not hold the settings');
  assert.equal(await page.isChecked('#switch-target_network'), false);
  assert(await page.isHidden('#none'));
  await page.click('#more');
  await sees(page, 'where', /^100 steps/);
  await page.click('#reset');
  await sees(page, 'where', /^0 steps/);
  await page.click('#train');
  await sees(page, 'story', /has not solved the task|The run has failed|lost it again/);
  assert.equal(await text(page, 'sha256'), trained(command).weights_sha256);
  assert.match(await text(page, 'story'), /no target network.*no replay memory.*learning rate of 0\.3/s);
  await page.click('#undo');
  await sees(page, 'command', /--config plain --seed 3 --out/);
  await page.fill('#seed', 'x');
  await page.keyboard.press('Enter');
  await sees(page, 'problem', /These settings give no run.*seed/);
  assert.equal(await text(page, 'command'), '', 'shows a command for what is refused');
  await page.close();
}

async function everyStepOfTheLadderIsAPreset(browser) {
  const page = await open(browser, '#budget.steps=600');
  const steps = await page.$$eval('optgroup option', options => options.map(option => option.value));
  const files = fs.readdirSync(path.join(__dirname, '../../configs/ladder')).sort();
  assert.deepEqual(steps.map(step => `${step.slice('ladder/'.length)}.json`), files);
  for (const step of steps) {
    await page.selectOption('#preset', step);
    await until(page, `settings.preset === '${step}' && run.policy`);
    assert.match(await text(page, 'command'), new RegExp(`^cartpole-dqn train --config ${step} --out`));
  }
  const soft = await open(browser, '#preset=ladder/04_soft_target&budget.steps=600');
  await soft.click('#train');
  await sees(soft, 'where', /The run has ended/);
  assert.equal(await text(soft, 'sha256'), trained(await text(soft, 'command')).weights_sha256);
  await page.close();
  await soft.close();
}

async function aSeedOf64BitsStaysItself(browser) {
  const seed = '18446744073709551615';
  const page = await open(browser, `#seed=${seed}&budget.steps=9007199254740993`);
  const command = await text(page, 'command');
  assert.match(command, new RegExp(`--seed ${seed} --set budget\\.steps=9007199254740993 `));
  assert.equal(await page.inputValue('#seed'), seed);
  const config = await page.inputValue('#config');
  assert.match(config, new RegExp(`"seed": ${seed}`));
  assert.match(config, /"steps": 9007199254740993/);
  const unfold = () => page.evaluate(() => document.querySelectorAll('details').forEach(details => { details.open = true; }));
  await unfold();
  // An edited config stays the text that it is, in the box, in the link and in the file.
  await page.fill('#config', '{"seed": 9007199254740993, "budget": {"steps": 200}, "replay": {"warmup_steps": 64}, "evaluation": {"every_steps": 100, "episodes": 5}}');
  await page.click('#use');
  await sees(page, 'command', /--config config\.json --out/);
  assert.match(decodeURIComponent(page.url()), /"seed":9007199254740993,/);
  await page.reload();
  await until(page, 'run.policy');
  assert.equal(await page.inputValue('#seed'), '9007199254740993');
  await unfold();
  fs.writeFileSync(path.join(directory, 'config.json'), await saved(page, 'save'));
  await page.click('#train');
  await sees(page, 'where', /The run has ended/);
  assert.equal(await text(page, 'sha256'), trained(await text(page, 'command')).weights_sha256);
  await page.close();
}

async function noLinkBreaksThePage(browser) {
  const fragments = [
    'preset=x%22%5D', 'preset=__proto__', 'preset=constructor', 'preset=%00', '%', '%E0%A4%A', '=1', 'gamma', 'config=%5B1%5D',
    'config=null', 'config={"seed":', '__proto__=1', 'toString=1', `gama${'a'.repeat(5000)}=1`, 'seed=1e400', 'network.hidden=[]',
  ];
  for (const fragment of fragments) {
    const page = await open(browser, `#${fragment}`);
    assert((await text(page, 'problem')).length < 1000, 'a message without an end');
    // There is a way back to a run.
    await page.goto(`${address}#seed=1`);
    await sees(page, 'command', /^cartpole-dqn train --seed 1 --out/);
    await page.close();
  }
}

async function whatIsRefusedHasNoCommand(browser) {
  for (const fragment of ['environment={"command":["touch","x"]}', 'gamma=2', 'config={"environment":{"command":["touch","x"]}}']) {
    const page = await open(browser, `#${fragment}`);
    await sees(page, 'problem', /These settings give no run/);
    assert(await onScreen(page, 'problem'));
    assert.equal(await text(page, 'command'), '');
    assert(await page.isVisible('#none') && await page.isHidden('#same') && await page.isDisabled('#train'));
    await page.setInputFiles('#file', path.join(directory, 'best.safetensors'));
    await until(page, 'episode.moment.steps > 5');
    await page.selectOption('#preset', 'plain');
    await sees(page, 'command', /^cartpole-dqn train --config plain --out/);
    assert(await page.isVisible('#same') && await page.isHidden('#message'));
    await page.close();
  }
}

async function pauseAndResetInterruptAnEvaluation(browser) {
  const page = await open(browser, '#network.hidden=[128,128]&replay.warmup_steps=64&budget.steps=100&evaluation.every_steps=60&evaluation.episodes=100000');
  const interrupted = async button => {
    await page.evaluate('globalThis.busy = worker, 0');
    await page.click('#train');
    await until(page, 'run.snapshot');
    await page.waitForTimeout(100);
    await page.click(button);
    await until(page, 'worker !== busy && run.policy');
  };
  await interrupted('#reset');
  await sees(page, 'where', /^0 steps/);
  await interrupted('#train');
  await sees(page, 'where', /^59 steps/);
  assert.equal(await text(page, 'train'), 'Train');
  await page.click('#train');
  await sees(page, 'where', /The run has ended/);
  const summary = trained(await text(page, 'command'));
  assert.equal(await text(page, 'sha256'), summary.weights_sha256);
  for (const name of ['best', 'last']) {
    const theirs = fs.readFileSync(path.join(directory, `runs/page/checkpoints/${name}.safetensors`));
    assert((await saved(page, name)).equals(theirs), `${name}.safetensors has other bytes than the program's`);
  }
  await page.close();
}

async function everybodyCanUseIt(browser) {
  for (const [width, scheme] of [[1200, 'dark'], [360, 'light']]) {
    const page = await open(browser, '#budget.steps=3000', { width, scheme, motion: 'reduce' });
    assert.equal(await text(page, 'play'), 'Play', 'moves although less motion is asked for');
    await page.click('#train');
    await sees(page, 'where', /The run has ended/);
    await page.evaluate(() => document.querySelectorAll('details').forEach(details => { details.open = true; }));
    assert.deepEqual(await page.evaluate(outside), [], `outside of ${width} px`);
    assert(await page.evaluate(() => document.documentElement.scrollWidth <= innerWidth), 'the page scrolls sideways');
    for (const selector of ['h1, h2, p, td, summary', 'output', 'label', 'figcaption']) {
      const { count, contrast, paper } = await page.evaluate(readable, selector);
      assert(count > 1 && contrast >= 4.5, `${selector}: contrast ${contrast} of ${count}`);
      assert.equal(paper < 0.5, scheme === 'dark', 'does not follow the colour scheme');
    }
    const nameless = await page.evaluate(() => [...document.querySelectorAll('button, input, select, textarea, canvas:not([aria-hidden])')]
      .filter(element => !(element.ariaLabel || element.labels?.[0]?.textContent.trim() || element.textContent.trim()))
      .map(element => element.outerHTML));
    assert.deepEqual(nameless, []);
    await screenshot(page, width === 360 ? 'phone' : 'desktop-dark');
    await page.close();
  }
}

// The modules in the browser's own engine.
async function everyModuleHasTheReferencesBits(browser) {
  const page = await open(browser);
  for (const name of ['relaxed-simd', 'simd128', 'scalar']) {
    const module = fs.readFileSync(path.join(options.modules, `${name}.wasm`)).toString('base64');
    const differing = await page.evaluate(async module => {
      const bytes = Uint8Array.from(atob(module), character => character.charCodeAt(0));
      const { exports } = (await WebAssembly.instantiate(bytes, {})).instance;
      return Array.from({ length: 100 }, (_, seed) => exports.differing_numbers(seed)).reduce((a, b) => a + b);
    }, module);
    assert.equal(differing, 0, `${name}: ${differing} numbers are not those of the reference`);
  }
  await page.close();
}

async function main() {
  if (!fs.existsSync(CHROMIUM)) {
    console.log(`NOT CHECKED: no Chromium at ${CHROMIUM}; install Debian's chromium, or set CHROMIUM to its path`);
    return options.require ? 1 : 0;
  }
  assert(fs.statSync(options.page).size < 1e6, 'the page has 1 MB');
  const { chromium } = require('playwright-core');
  const browser = await chromium.launchPersistentContext(path.join(directory, 'profile'), { executablePath: CHROMIUM, args: ARGUMENTS });
  try {
    const checks = [
      theDefaultIsSolvedWithTheProgramsBits, aCheckpointIsPlayed, aChangedRunIsTheOneOfItsCommand, everyStepOfTheLadderIsAPreset,
      aSeedOf64BitsStaysItself, noLinkBreaksThePage, whatIsRefusedHasNoCommand, pauseAndResetInterruptAnEvaluation,
      everybodyCanUseIt, everyModuleHasTheReferencesBits,
    ];
    for (const check of checks) {
      await check(browser);
      assert.deepEqual(problems, []);
      console.log(`${check.name}: ok`);
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
