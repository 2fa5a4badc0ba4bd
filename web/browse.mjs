// Open pages in Chromium without a network. Standard input: {"executable", "flags", "jobs": [{"url",
// "expression" or "script", "before", "width", "height", "screenshot", "online"}]}. An expression is evaluated in the
// page when it is loaded; a script is the body of an asynchronous function of `page`, the object of playwright, and
// starts before; `before` runs in each frame before its own scripts. Standard output: one result for each job: its
// value, errors and warnings of the console, requests.
import { chromium } from "playwright-core";

const { executable, flags, jobs } = JSON.parse(await new Response(process.stdin).text());
const browser = await chromium.launch({
  executablePath: executable,
  ignoreDefaultArgs: ["--disable-gpu"],
  args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist", "--disable-dev-shm-usage", "--js-flags=--expose-gc", ...flags],
});
const AsyncFunction = (async () => {}).constructor;
// Chromium reports the time that a test itself spends with reading pixels as a warning. It is no fault of a page.
const isReportOfTime = (text) => /GL Driver Message \(OpenGL, Performance,/.test(text);
const results = [];
for (const job of jobs) {
  const context = await browser.newContext({ viewport: { width: job.width ?? 700, height: job.height ?? 620 }, offline: !job.online });
  const page = await context.newPage();
  const errors = [];
  const requests = [];
  page.on("console", (message) => {
    if (["error", "warning"].includes(message.type()) && !isReportOfTime(message.text())) errors.push(message.text());
  });
  page.on("pageerror", (error) => errors.push(String(error)));
  page.on("request", (request) => /^(https?|wss?):/.test(request.url()) && requests.push(request.url()));
  if (job.before) await page.addInitScript(job.before);
  let value = null;
  try {
    await page.goto(job.url, { waitUntil: job.script ? "commit" : "load", timeout: 120_000 });
    value = job.script ? await new AsyncFunction("page", job.script)(page) : await page.evaluate(job.expression);
    if (job.screenshot) await page.screenshot({ path: job.screenshot });
  } catch (error) {
    errors.push(String(error));
  }
  results.push({ value, errors, requests });
  await context.close();
}
await browser.close();
process.stdout.write(JSON.stringify(results));
