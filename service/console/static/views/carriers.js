/** @file Carriers: which one lies, since when, and whom it concerns: all, one transponder, one user. */

import { element, fill, setText } from "../element.js";
import { choice } from "../lists/table.js";
import { MOST_NAMED, affected } from "./carriers/affected.js";
import { carrierMap } from "./carriers/map.js";
import { followCarriers } from "./carriers/model.js";
import { carrierTable } from "./carriers/table.js";
import { carrierMultiples } from "./carriers/multiples.js";
import { stateLevel } from "./carriers/words.js";
import { oneCarrier } from "./carriers/one.js";
import { failure } from "../parts/problem.js";
import { symbol } from "../parts/symbol.js";
import { number, words } from "../words.js";

export const name = "carriers";
const FORMS = ["table", "multiples"];

/** @param {{store: any, spacecraft: any, parameters: URLSearchParams, go: (view: string, parameters?: any) => void}} context */
export function show(context) {
  const chosen = context.parameters.get("carrier");
  const problem = element("div");
  const body = chosen ? oneCarrier(context, chosen) : everyCarrier(context);
  const end = followCarriers(context, (carriers) => {
    fill(problem, carriers.problem && failure(carriers.problem));
    body.draw(carriers);
  });
  const node = element("section", { class: "carriers", "aria-label": words("views.carriers.title") }, problem, body.node);
  return {
    node,
    close() {
      end();
      body.close?.();
    },
  };
}

function everyCarrier({ spacecraft, parameters, go }) {
  const form = FORMS.includes(parameters.get("form")) ? parameters.get("form") : FORMS[0];
  const mark = element("span");
  const sentence = element("span");
  const notice = element("p", { class: "detail" });
  const part = form === "table" ? carrierTable() : carrierMultiples();
  const map = element("figure", { class: "map-side" });
  const forms = choice(words("views.carriers.form.title"), FORMS.map((each) => [each, words(`views.carriers.form.${each}`)]), (each) => go(name, { form: each }), form);
  const node = element("div", { class: "every" }, element("div", { role: "status" }, element("h1", { class: "verdict" }, mark, sentence)),
    forms, element("div", { class: "sides" }, part.node, map), notice,
  );
  let shownPlan = null;
  let shownMap = "";
  return {
    node,
    draw(carriers) {
      const listed = carriers.plan?.carriers ?? [];
      const whom = affected(listed, carriers.states, carriers.attitude);
      fill(mark, symbol(whom.level));
      setText(sentence, ` ${affectedWords(whom)}`);
      setText(notice, noticeOf(carriers));
      if (shownPlan !== carriers.plan) part.reset(listed);
      shownPlan = carriers.plan;
      part.draw(carriers);
      const levelOf = (id) => stateLevel(carriers.states.get(id));
      const key = JSON.stringify([carriers.plan?.plan_id, carriers.calibration?.id, listed.map(({ id }) => levelOf(id))]);
      if (key === shownMap) return;
      shownMap = key;
      fill(map,
        listed.length > 0 && carrierMap({ longitudeDeg: spacecraft.longitude_deg, carriers: listed, calibration: carriers.calibration, levelOf }),
        element("figcaption", { class: "detail" }, words(`views.carriers.map.${carriers.calibration ? "arrows" : "noArrows"}`)),
      );
    },
  };
}

/** Return the sentence about who is affected. */
export function affectedWords({ kind, count, total, name: group, ids, common }) {
  const named = ids.slice(0, MOST_NAMED).join(", ");
  const list = ids.length > MOST_NAMED ? words("views.carriers.affected.more", { named, more: ids.length - MOST_NAMED }) : named;
  return words(`views.carriers.affected.${kind}`, { count, total, name: group, list, common: number(Math.abs(common), 1) });
}

function noticeOf({ plan, calibration, states }) {
  if (plan && !states.size) return words("views.carriers.noRows");
  return plan && !calibration ? words("views.carriers.noCalibration") : "";
}
