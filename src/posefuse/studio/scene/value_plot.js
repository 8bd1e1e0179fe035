import { listen, VALUES } from "posefuse-studio";

const COLOURS = ["#26a69a", "#ef6c00", "#5c6bc0", "#d81b60", "#7cb342", "#00acc1"];
const LEAST_RANGE = 20;

export default {
  template: `<div><canvas></canvas></div>`,
  props: { stream: String, places: Array, labels: Array, unit: String, seconds: Number },
  mounted() {
    this.canvas = this.$el.children[0];
    this.past = [];
    this.waiting = false;
    this.leave = listen(this.stream, (message) => {
      if (message.kind !== VALUES) return;
      if (this.past.length && message.t_s < this.past[this.past.length - 1].t_s) this.past = [];
      this.past.push(message);
      while (this.past.length && this.past[0].t_s < message.t_s - this.seconds) this.past.shift();
      if (this.waiting) return;
      this.waiting = true;
      requestAnimationFrame(() => {
        this.waiting = false;
        this.draw();
      });
    });
  },
  beforeUnmount() { this.leave?.(); },
  methods: {
    draw() {
      const ratio = window.devicePixelRatio || 1, width = this.$el.clientWidth, height = this.$el.clientHeight;
      if (!width || !height || !this.past.length) return;
      this.canvas.width = width * ratio;
      this.canvas.height = height * ratio;
      const pen = this.canvas.getContext("2d");
      pen.scale(ratio, ratio);
      const ink = getComputedStyle(this.$el).color, left = 40, bottom = height - 18, top = 8;
      const [low, high] = this.range();
      const end = this.past[this.past.length - 1].t_s;
      const x = (t_s) => width - 8 - ((end - t_s) / this.seconds) * (width - left - 8);
      const y = (value) => bottom - ((value - low) / (high - low)) * (bottom - top);
      pen.font = "11px Roboto, sans-serif";
      pen.fillStyle = pen.strokeStyle = ink;
      for (let i = 0; i <= 4; i++) {
        const value = low + ((high - low) * i) / 4;
        pen.globalAlpha = 0.15;
        pen.fillRect(left, y(value), width - left - 8, 1);
        pen.globalAlpha = 0.75;
        pen.fillText(`${Math.round(value)}`, 8, y(value) + 4);
      }
      pen.fillText(`${this.unit}, last ${this.seconds} s`, left, height - 4);
      this.places.forEach((place, i) => this.line(pen, place, COLOURS[i % COLOURS.length], x, y));
    },
    line(pen, place, colour, x, y) {
      pen.strokeStyle = pen.fillStyle = colour;
      const known = this.past.filter(({ values }) => !Number.isNaN(values[2 * place]));
      const band = known.filter(({ values }) => !Number.isNaN(values[2 * place + 1]));
      pen.globalAlpha = 0.18;
      pen.beginPath();
      for (const { t_s, values } of band) pen.lineTo(x(t_s), y(values[2 * place] + 2 * values[2 * place + 1]));
      for (const { t_s, values } of band.reverse()) pen.lineTo(x(t_s), y(values[2 * place] - 2 * values[2 * place + 1]));
      pen.fill();
      pen.globalAlpha = 1;
      pen.lineWidth = 1.8;
      pen.beginPath();
      for (const { t_s, values } of known) pen.lineTo(x(t_s), y(values[2 * place]));
      pen.stroke();
    },
    range() {
      const values = this.past.flatMap((one) => this.places.map((place) => one.values[2 * place])).filter((v) => !Number.isNaN(v));
      if (!values.length) return [-LEAST_RANGE / 2, LEAST_RANGE / 2];
      const low = Math.min(...values), high = Math.max(...values), spare = Math.max((LEAST_RANGE - (high - low)) / 2, 3);
      return [Math.floor((low - spare) / 5) * 5, Math.ceil((high + spare) / 5) * 5];
    },
  },
};
