import { listen, SETUP, POSES, LABELS, RigDrawing } from "posefuse-studio";

export default {
  template: `<div><canvas></canvas><div class="pf-labels"></div>
    <div v-if="!own" class="pf-sides"><span v-for="(colour, side) in sides" :style="{ color: colour }">{{ side }}</span></div></div>`,
  props: { stream: String, skeletons: Boolean, ellipsoids: Boolean, trails: Boolean, cameras: Boolean },
  // own: people are drawn in colours of their own, so sides have none
  data: () => ({ sides: {}, own: false }),
  mounted() {
    try {
      this.drawing = new RigDrawing(this.$el, this.$el.children[0], this.$el.children[1]);
    } catch {
      this.$el.textContent = "This browser cannot draw in 3D (WebGL is off).";
      return;
    }
    const { skeletons, ellipsoids, trails, cameras } = this;
    this.drawing.show({ skeletons, ellipsoids, trails, cameras });
    this.leave = listen(this.stream, (message) => {
      if (message.kind === SETUP) {
        this.drawing.take_setup(message.content);
        this.sides = message.content.sides || {};
      } else if (message.kind === POSES) {
        this.drawing.take_poses(message);
        this.own = message.rgba.some((rgba) => rgba[3]);
      }
      else if (message.kind === LABELS) this.drawing.names = message.content;
    });
  },
  beforeUnmount() {
    this.leave?.();
    this.drawing?.close();
  },
  watch: {
    skeletons(on) { this.drawing?.show({ skeletons: on }); },
    ellipsoids(on) { this.drawing?.show({ ellipsoids: on }); },
    trails(on) { this.drawing?.show({ trails: on }); },
    cameras(on) { this.drawing?.show({ cameras: on }); },
  },
  methods: {
    look(where) { this.drawing?.look(where); },
  },
};
