import { listen, Seen, VALUES } from "posefuse-studio";

const LEAST_RANGE = 20, MOST_LINES = 5, LEFT = 40, RIGHT = 8, TOP = 8, BOTTOM = 18;
// curves of seconds need fewer updates than a skeleton
const EVERY_MS = 100, GAP_S = 0.3, DASH_PX = 6, SHOWN_S = 10;

export default {
  template: `<div><canvas></canvas><div class="pf-plot-names">
    <span v-for="(label, i) in labels" :style="{ borderColor: colours[i], borderLeftStyle: dash(i) ? 'dashed' : 'solid' }">{{ label }}</span></div></div>`,
  props: { stream: String, places: Array, labels: Array, colours: Array },
  mounted() {
    this.canvas = this.$el.children[0];
    this.past = [];
    this.waiting = 0;
    this.seen = new Seen(this.$el, () => this.draw_soon());
    this.leave = listen(this.stream, (message) => {
      if (message.kind !== VALUES) return;
      if (this.past.length && message.t_s < this.past[this.past.length - 1].t_s) this.past = [];
      this.past.push(message);
      while (this.past[0].t_s < message.t_s - SHOWN_S) this.past.shift();
      this.draw_soon();
    });
  },
  beforeUnmount() {
    this.leave?.();
    this.seen.close();
    clearTimeout(this.waiting);
  },
  methods: {
    // the second curve of a colour is dashed, and the dashes of more are longer
    dash(i) { return DASH_PX * this.colours.slice(0, i).filter((one) => one === this.colours[i]).length; },
    draw_soon() {
      if (this.past.length && this.seen.now) this.waiting ||= setTimeout(() => requestAnimationFrame(() => this.draw()), EVERY_MS);
    },
    draw() {
      this.waiting = 0;
      const width = this.canvas.clientWidth, height = this.canvas.clientHeight;
      if (!width || !height) return;
      const pen = this.cleared(width, height), bottom = height - BOTTOM;
      const [low, high, step] = this.range();
      const end = this.past[this.past.length - 1].t_s;
      const x = (t_s) => width - RIGHT - ((end - t_s) / SHOWN_S) * (width - LEFT - RIGHT);
      const y = (value) => bottom - ((value - low) / (high - low)) * (bottom - TOP);
      pen.font = "11px Roboto, sans-serif";
      pen.fillStyle = getComputedStyle(this.$el).color;
      for (let value = low; value <= high; value += step) {
        pen.globalAlpha = 0.15;
        pen.fillRect(LEFT, y(value), width - LEFT - RIGHT, 1);
        pen.globalAlpha = 0.75;
        pen.fillText(`${value}`, 8, y(value) + 4);
      }
      pen.fillText(`deg, last ${SHOWN_S} s`, LEFT, height - 4);
      this.places.forEach((place, i) => this.line(pen, place, i, x, y));
    },
    // the canvas at the size of its element
    cleared(width, height) {
      const ratio = window.devicePixelRatio || 1, pen = this.canvas.getContext("2d");
      const [wide, high] = [Math.round(width * ratio), Math.round(height * ratio)];
      if (this.canvas.width !== wide || this.canvas.height !== high) Object.assign(this.canvas, { width: wide, height: high });
      pen.setTransform(ratio, 0, 0, ratio, 0, 0);
      pen.globalAlpha = 1;
      pen.clearRect(0, 0, width, height);
      return pen;
    },
    line(pen, place, i, x, y) {
      pen.strokeStyle = pen.fillStyle = this.colours[i];
      pen.setLineDash(this.dash(i) ? [this.dash(i)] : []);
      pen.lineWidth = 1.8;
      for (const run of this.runs(place)) {
        const band = run.filter(({ values }) => !Number.isNaN(values[2 * place + 1]));
        pen.globalAlpha = 0.18;
        pen.beginPath();
        for (const { t_s, values } of band) pen.lineTo(x(t_s), y(values[2 * place] + 2 * values[2 * place + 1]));
        for (const { t_s, values } of band.reverse()) pen.lineTo(x(t_s), y(values[2 * place] - 2 * values[2 * place + 1]));
        pen.fill();
        pen.globalAlpha = 1;
        pen.beginPath();
        for (const { t_s, values } of run) pen.lineTo(x(t_s), y(values[2 * place]));
        pen.stroke();
      }
    },
    // stretches in which the angle was known: nothing is drawn where the person was lost
    runs(place) {
      const runs = [];
      let last_s = -Infinity;
      for (const one of this.past) {
        if (Number.isNaN(one.values[2 * place])) continue;
        if (one.t_s - last_s > GAP_S) runs.push([]);
        runs[runs.length - 1].push(one);
        last_s = one.t_s;
      }
      return runs;
    },
    // lowest and highest round value, and the distance of the lines between
    range() {
      const values = this.past.flatMap((one) => this.places.map((place) => one.values[2 * place])).filter((v) => !Number.isNaN(v));
      const low = values.length ? Math.min(...values) : 0, high = values.length ? Math.max(...values) : 0;
      const spare = Math.max((LEAST_RANGE - (high - low)) / 2, 3);
      const step = [5, 10, 20, 50, 100].find((one) => (high - low + 2 * spare) / one <= MOST_LINES) || 200;
      return [Math.floor((low - spare) / step) * step, Math.ceil((high + spare) / step) * step, step];
    },
  },
};
