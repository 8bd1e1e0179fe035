// People as skinned meshes: the vertices lie on the graphics card, a frame brings one matrix per joint.

import { THREE } from "nicegui-scene";

const WITH_SKELETON = 0.5;

export class Bodies {
  // `surface`: makes a material of a roughness
  constructor(scene, surface) {
    this.surface = surface;
    this.group = new THREE.Group();
    this.slots = new Map();
    this.clear = false;
    scene.add(this.group);
  }

  take_mesh({ slot, revision, joints, vertices, weight, joint, faces }) {
    this.remove(slot);
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(vertices, 3));
    geometry.setAttribute("skinWeight", new THREE.BufferAttribute(weight, 4));
    geometry.setAttribute("skinIndex", new THREE.BufferAttribute(joint, 4));
    geometry.setIndex(new THREE.BufferAttribute(faces, 1));
    geometry.computeVertexNormals();
    const mesh = new THREE.SkinnedMesh(geometry, this.surface(0.75));
    // bones stand outside the scene: their matrices are what the message says
    const bones = Array.from({ length: joints }, () => new THREE.Bone());
    mesh.bind(new THREE.Skeleton(bones, bones.map(() => new THREE.Matrix4())), new THREE.Matrix4());
    mesh.frustumCulled = false;
    mesh.visible = false;
    this.slots.set(slot, { revision, mesh });
    this.group.add(mesh);
    this.set_clear(this.clear);
  }

  take_bodies({ bodies }) {
    for (const { mesh } of this.slots.values()) mesh.visible = false;
    for (const { slot, revision, rgba, matrices } of bodies) {
      const own = this.slots.get(slot);
      if (own?.revision !== revision) continue;
      own.mesh.skeleton.bones.forEach((bone, j) => bone.matrixWorld.set(...matrices.subarray(12 * j, 12 * j + 12), 0, 0, 0, 1));
      own.mesh.material.color.setRGB(rgba[0] / 255, rgba[1] / 255, rgba[2] / 255, THREE.SRGBColorSpace);
      own.mesh.visible = true;
      window.posefuseDrawn.bodies++;
    }
  }

  // a skeleton is seen through its body
  set_clear(on) {
    this.clear = on;
    for (const { mesh } of this.slots.values()) {
      Object.assign(mesh.material, { transparent: on, opacity: on ? WITH_SKELETON : 1, depthWrite: !on, needsUpdate: true });
    }
  }

  remove(slot) {
    const own = this.slots.get(slot);
    if (!own) return;
    this.slots.delete(slot);
    this.group.remove(own.mesh);
    own.mesh.geometry.dispose();
    own.mesh.material.dispose();
    own.mesh.skeleton.dispose();
  }

  close() {
    for (const slot of [...this.slots.keys()]) this.remove(slot);
  }
}
