// The order in which the windows of a tab draw their first pictures. Browsers keep at most 16 WebGL contexts alive per
// process and drop the oldest, so that twenty pages in frames of one document would take the contexts of each other.
//
// Every window with work to do sends "waiting" to all other windows of its tab, and "done" afterwards; a window that still
// waits answers "waiting" with "here". A window starts when fewer than LIMIT windows before it in the tree of frames wait or
// draw. Messages between windows work without a common origin, unlike locks and channels.

/** Largest number of windows that draw at the same time. */
const LIMIT = 4;
/** Time for answers of other windows, and between two checks of the order, milliseconds. */
const ANSWER_MS = 100;

type Message = "waiting" | "here" | "done";

const others = new Set<MessageEventSource>();
/** Number of works of this window that wait or run. */
let own = 0;
let isListening = false;

/** All windows of the tab, each before its children. */
function windows(root: Window = window.top ?? window): Window[] {
  return [root, ...Array.from({ length: root.length }, (_, i) => windows(root[i])).flat()];
}

function send(message: Message, receivers: Window[] = windows()): void {
  for (const receiver of receivers) if (receiver !== window) receiver.postMessage({ fieldbake: message }, "*");
}

function listen(): void {
  if (isListening) return;
  isListening = true;
  window.addEventListener("message", ({ source, data }) => {
    const message: Message | undefined = data?.fieldbake;
    if (!source || !message) return;
    if (message === "done") others.delete(source);
    else others.add(source);
    if (message === "waiting" && own > 0) send("here", [source as Window]);
  });
  // A window that goes away while it waits holds no other window back.
  window.addEventListener("pagehide", () => own > 0 && send("done"));
}

/** Whether fewer than LIMIT windows before this one wait or draw. Windows that were removed are in no tree. */
function isTurn(): boolean {
  const all = windows();
  return all.slice(0, all.indexOf(window)).filter((other) => others.has(other)).length < LIMIT;
}

/** Run `work` when it is this window's turn. */
export async function inTurn(work: () => Promise<void>): Promise<void> {
  listen();
  own++;
  try {
    if (windows().length > 1) {
      if (own === 1) send("waiting");
      do await new Promise((done) => setTimeout(done, ANSWER_MS));
      while (!isTurn());
    }
    await work();
  } finally {
    own--;
    if (own === 0) send("done");
  }
}
