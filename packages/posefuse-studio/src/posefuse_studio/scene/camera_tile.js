import { listen, Seen, SETUP, IMAGE } from "posefuse-studio";

export default {
  template: `<div><canvas></canvas></div>`,
  props: { stream: String, camera: Number, aspect: Number, overlay: Boolean },
  mounted() {
    this.$el.style.aspectRatio = String(this.aspect);
    this.canvas = this.$el.children[0];
    this.bones = [];
    this.busy = false;
    this.newest = this.last = null;
    this.seen = new Seen(this.$el, () => this.draw());
    this.leave = listen(this.stream, (message) => {
      if (message.kind === SETUP) this.bones = message.content.bones;
      else if (message.kind === IMAGE && message.camera === this.camera) {
        this.newest = message;
        this.draw();
      }
    });
  },
  beforeUnmount() {
    this.leave?.();
    this.seen.close();
  },
  watch: {
    overlay() {
      this.newest ||= this.last;
      this.draw();
    },
  },
  methods: {
    async draw() {
      const message = this.newest;
      if (this.busy || !message || !this.seen.now) return;
      this.busy = true;
      this.last = message;
      this.newest = null;
      try {
        if (!message.jpeg.size) return this.draw_missing(message);
        const image = await createImageBitmap(message.jpeg);
        if (this.canvas.width !== image.width || this.canvas.height !== image.height) {
          this.canvas.width = image.width;
          this.canvas.height = image.height;
        }
        const pen = this.canvas.getContext("2d", { alpha: false });
        pen.drawImage(image, 0, 0);
        image.close();
        if (this.overlay) this.draw_over(pen, message);
        window.posefuseDrawn.tile++;
      } catch {
        // a damaged image: the next one is another
      } finally {
        this.busy = false;
      }
      // what came while this was decoded; of several the newest
      this.draw();
    },
    draw_missing({ width, height }) {
      Object.assign(this.canvas, { width, height });
      const pen = this.canvas.getContext("2d", { alpha: false });
      pen.fillStyle = "#9db1bd";
      pen.font = `${Math.round(height / 16)}px Roboto, sans-serif`;
      pen.textAlign = "center";
      pen.fillText("no image at this time", width / 2, height / 2);
    },
    draw_over(pen, { detections, people, keypoints, rgba, seen, fused }) {
      pen.lineWidth = 2;
      for (let n = 0; n < people; n++) {
        const [r, g, b] = rgba[n];
        pen.strokeStyle = `rgb(${r},${g},${b})`;
        pen.beginPath();
        for (const [from, to] of this.bones) {
          const a = 2 * (n * keypoints + from), c = 2 * (n * keypoints + to);
          if (Number.isNaN(fused[a]) || Number.isNaN(fused[c])) continue;
          pen.moveTo(fused[a], fused[a + 1]);
          pen.lineTo(fused[c], fused[c + 1]);
        }
        pen.stroke();
      }
      pen.fillStyle = "rgb(255,220,60)";
      for (let i = 0; i < detections * keypoints; i++) {
        if (!Number.isNaN(seen[2 * i])) pen.fillRect(seen[2 * i] - 1.5, seen[2 * i + 1] - 1.5, 3, 3);
      }
    },
  },
};
