(async () => {
  const data = await pageData;
  const sideOf = { left: "left", right: "right", mid: "mid" };

  const playerOf = (root, content) => {
    const canvas = root.querySelector("canvas"), context = canvas.getContext("2d");
    const [play, slider, clock, speed, view, follow] = [".play", ".time", "output", ".speed", ".view", ".follow"].map(name => root.querySelector(name));
    const time = content.t, people = content.people.map(one => one.xyz);
    const bounds = boundsOf(people);
    let now = 0, running = false, yaw = -0.9, pitch = 0.15, zoom = 1, last = 0, queued = false;
    slider.max = Math.max(0, time.length - 1);

    const point = (person, k, i) => {
      const [x, y, z] = [0, 1, 2].map(axis => person[k][axis][i]);
      return x === null || y === null || z === null ? null : [x, y, z];
    };
    const centre = i => {
      if (!follow.checked) return bounds.middle;
      const seen = people.flatMap(person => person.map((_, k) => point(person, k, i))).filter(Boolean);
      if (!seen.length) return bounds.middle;
      return [0, 1].map(axis => seen.reduce((sum, p) => sum + p[axis], 0) / seen.length).concat(bounds.middle[2]);
    };

    const draw = () => {
      queued = false;
      const ratio = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
      if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
        canvas.width = Math.round(width * ratio);
        canvas.height = Math.round(height * ratio);
      }
      context.setTransform(ratio, 0, 0, ratio, 0, 0);
      context.clearRect(0, 0, width, height);
      const about = centre(now), shown = follow.checked ? bounds.height : Math.max(bounds.height, bounds.across);
      const scale = zoom * 0.8 * Math.min(height / shown, width / (follow.checked ? 1.2 : bounds.across));
      const [cy, sy, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
      const onScreen = p => {
        const [x, y, z] = p.map((value, axis) => value - about[axis]);
        const right = cy * x + sy * y, away = -sy * x + cy * y;
        return [width / 2 + scale * right, height / 2 - scale * (cp * z + sp * away)];
      };
      const line = (a, b, ink, thick) => {
        context.strokeStyle = ink;
        context.lineWidth = thick;
        context.beginPath();
        context.moveTo(...onScreen(a));
        context.lineTo(...onScreen(b));
        context.stroke();
      };
      const { low, high } = bounds;
      for (let x = low[0]; x <= high[0] + 1e-6; x += bounds.cell) line([x, low[1], 0], [x, high[1], 0], colour("line"), 1);
      for (let y = low[1]; y <= high[1] + 1e-6; y += bounds.cell) line([low[0], y, 0], [high[0], y, 0], colour("line"), 1);
      context.lineCap = "round";
      people.forEach(person => content.bones.forEach(([a, b], n) => {
        const from = point(person, a, now), to = point(person, b, now);
        if (from && to) line(from, to, colour(sideOf[content.sides[n]]), 4);
      }));
      context.fillStyle = colour("soft");
      context.font = "12px system-ui, sans-serif";
      people.forEach((person, n) => {
        const top = person.map((_, k) => point(person, k, now)).filter(Boolean).sort((a, b) => b[2] - a[2])[0];
        if (top && people.length > 1) context.fillText(content.people[n].name, onScreen(top)[0] + 8, onScreen(top)[1] - 8);
      });
      context.fillText(`squares of ${bounds.cell} m`, 10, height - 10);
      ["left", "right"].forEach((side, n) => {
        context.fillStyle = colour(side);
        context.fillText(side, 10 + 32 * n, height - 28);
      });
      clock.textContent = time.length ? `${time[now].toFixed(2)} s` : "";
      slider.value = now;
    };
    const later = () => { if (!queued) { queued = true; requestAnimationFrame(draw); } };

    const advance = stamp => {
      if (!running) return;
      const passed = last ? (stamp - last) / 1000 * Number(speed.value) : 0;
      const goal = time[now] + passed;
      let next = now;
      while (next + 1 < time.length && time[next + 1] <= goal) next++;
      if (next !== now || !last) last = stamp;
      now = next >= time.length - 1 ? 0 : next;
      draw();
      requestAnimationFrame(advance);
    };
    const run = on => {
      running = on && time.length > 1;
      play.textContent = running ? "Pause" : "Play";
      last = 0;
      if (running) requestAnimationFrame(advance);
    };
    const go = to => { now = Math.min(Math.max(0, to), time.length - 1); later(); };

    play.addEventListener("click", () => run(!running));
    slider.addEventListener("input", () => { run(false); go(Number(slider.value)); });
    follow.addEventListener("change", later);
    view.addEventListener("change", () => {
      const facing = facingAt(people, content, now);
      ({ side: () => { yaw = facing; pitch = 0; }, front: () => { yaw = facing + Math.PI / 2; pitch = 0; }, top: () => { yaw = facing; pitch = Math.PI / 2; } })[view.value]?.();
      later();
    });
    canvas.addEventListener("keydown", event => {
      const act = { " ": () => run(!running), ArrowLeft: () => go(now - 1), ArrowRight: () => go(now + 1) }[event.key];
      if (act) { event.preventDefault(); act(); }
    });
    turnedBy(canvas, (dx, dy) => {
      yaw += dx * 0.01;
      pitch = Math.min(Math.PI / 2, Math.max(-0.3, pitch + dy * 0.01));
      view.value = "free";
      later();
    }, factor => { zoom = Math.min(8, Math.max(0.3, zoom * factor)); later(); });
    new ResizeObserver(later).observe(canvas);
    dark.addEventListener("change", later);
    matchMedia("print").addEventListener("change", draw);
    draw();
  };

  // the extent of all people over all of time, rounded outwards to whole squares of the ground
  const boundsOf = people => {
    const low = [Infinity, Infinity, 0], high = [-Infinity, -Infinity, 1];
    for (const person of people) for (const axes of person) axes.forEach((values, axis) => {
      for (const v of values) if (v !== null) { low[axis] = Math.min(low[axis], v); high[axis] = Math.max(high[axis], v); }
    });
    for (const axis of [0, 1]) if (low[axis] > high[axis]) { low[axis] = -1; high[axis] = 1; }
    const cell = Math.max(high[0] - low[0], high[1] - low[1]) > 8 ? 1 : 0.5;
    for (const axis of [0, 1]) {
      low[axis] = cell * Math.floor(low[axis] / cell - 0.5);
      high[axis] = cell * Math.ceil(high[axis] / cell + 0.5);
    }
    const across = Math.hypot(high[0] - low[0], high[1] - low[1]), height = high[2] - low[2];
    return { low, high, cell, across, height, middle: [0, 1].map(axis => (low[axis] + high[axis]) / 2).concat((low[2] + high[2]) / 2) };
  };

  // the angle of the direction the first person faces, across the bone from right to left that is longest on the ground
  const facingAt = (people, content, i) => {
    let best = null;
    for (const person of people) for (const [a, b] of content.across) {
      const [right, left] = [a, b].map(k => [0, 1].map(axis => person[k][axis][i]));
      if (right.includes(null) || left.includes(null)) continue;
      const line = [left[0] - right[0], left[1] - right[1]];
      if (!best || Math.hypot(...line) > Math.hypot(...best)) best = line;
    }
    return best ? Math.atan2(-best[0], best[1]) : 0;
  };

  const turnedBy = (canvas, turn, magnify) => {
    const held = new Map();
    const apart = () => { const [a, b] = [...held.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]); };
    canvas.addEventListener("pointerdown", event => { held.set(event.pointerId, [event.clientX, event.clientY]); canvas.setPointerCapture(event.pointerId); });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, event => held.delete(event.pointerId));
    canvas.addEventListener("pointermove", event => {
      const before = held.get(event.pointerId);
      if (!before) return;
      const span = held.size > 1 ? apart() : 0;
      held.set(event.pointerId, [event.clientX, event.clientY]);
      if (span) magnify(apart() / span);
      else turn(event.clientX - before[0], event.clientY - before[1]);
    });
    canvas.addEventListener("wheel", event => { event.preventDefault(); magnify(Math.exp(-event.deltaY * 0.001)); }, { passive: false });
  };

  document.querySelectorAll(".player").forEach((root, place) => playerOf(root, data.players[place]));
})();
