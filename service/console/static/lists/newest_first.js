/** @file A list read from its newest row backwards, page by page; what stands stays while a page cannot be read. */

import { Problem, get } from "../api.js";
import { element, fill } from "../element.js";
import { words } from "../words.js";
import { failure } from "../parts/problem.js";

const PAGE_ROWS = 100;
const SOON_MS = 300;

/**
 * Return a function that acts once for all its calls of a short time: a flood of alarms is one question.
 * @param {() => void} act
 */
export function soon(act) {
  let timer = 0;
  return () => {
    timer ||= setTimeout(() => {
      timer = 0;
      act();
    }, SOON_MS);
  };
}

/**
 * @param {string} path @param {(rows: any[], answer: any) => any} draw Returns the node for all rows read so far.
 * @returns {{node: Element, load: (params: Object<string, any>) => Promise<void>, reload: () => Promise<void>, redraw: () => void, close: () => void}}
 */
export function newestFirst(path, draw) {
  const ending = new AbortController();
  const body = element("div", { class: "rows" });
  const said = element("div", { "aria-live": "polite" });
  const older = element("button", { type: "button", hidden: true, onclick: () => read(newest.next) }, words("app.list.older"));
  let rows = [];
  let newest = { next: null };
  let params = {};
  let asked = 0;

  const redraw = () => fill(body, rows.length ? draw(rows, newest) : element("p", { class: "notice" }, words("app.list.empty")));

  async function read(cursor) {
    const turn = (asked += 1);
    older.disabled = true;
    try {
      const answer = await get(path, { ...params, order: "desc", limit: PAGE_ROWS, cursor }, { signal: ending.signal });
      // a question that was asked later has the word
      if (turn !== asked) return;
      rows = cursor ? [...rows, ...answer.rows] : answer.rows;
      newest = answer;
      fill(said);
      redraw();
    } catch (error) {
      if (ending.signal.aborted || turn !== asked) return;
      if (!(error instanceof Problem)) throw error;
      fill(said, failure(error), element("button", { type: "button", onclick: () => read(cursor) }, words("app.list.again")));
    } finally {
      older.disabled = false;
      older.hidden = !newest.next;
    }
  }

  return {
    node: element("div", { class: "list" }, said, body, older),
    load(wanted) {
      params = wanted;
      return read(null);
    },
    reload: () => read(null),
    redraw,
    close: () => ending.abort(),
  };
}
