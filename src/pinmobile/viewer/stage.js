// Functions that meshcat's commands lack: camera target, soft light, caption, legend and player.
// The values are properties of the node meshcat/stage, live or animated; `viewer` is the viewer of meshcat.
"use strict";
(() => {
  const THREE = MeshCat.THREE;
  const element = (id) => document.getElementById(id);
  // Looked up each time: a new scene has new nodes.
  const node = (name) => viewer.scene_tree.find(["meshcat", name]).object;
  let stage = node("stage");
  const seen = {};
  const changed = (name) => {
    const text = JSON.stringify(stage[name]);
    const is_new = text !== undefined && seen[name] !== text;
    seen[name] = text;
    return is_new;
  };

  const sun = new THREE.DirectionalLight(0xffffff, 0.36);
  sun.castShadow = true;
  sun.shadow.mapSize.set(1024, 1024);
  sun.shadow.radius = 3;
  viewer.scene.add(sun, sun.target);

  // A ghost at the place of a solid robot shows as a rim around it. Its depth is therefore increased, as if it were
  // farther from the camera. The orientation of triangles cannot help, because many meshes have mixed orientations.
  const farther = { value: 0 }; // [m]
  function stand_behind(material) {
    material.onBeforeCompile = (shader) => {
      shader.uniforms.farther = farther;
      shader.vertexShader = "uniform float farther;\n" + shader.vertexShader.replace(
        "#include <project_vertex>",
        `#include <project_vertex>
        vec4 behind = projectionMatrix * (mvPosition - vec4(0.0, 0.0, farther, 0.0));
        gl_Position.z = behind.z / behind.w * gl_Position.w;`,
      );
    };
  }

  // In meshcat, all objects cast shadows; flat and translucent objects should not.
  const set_object = viewer.set_object;
  const from_json = viewer.set_object_from_json;
  let coming = 0; // texts are pictures, which load asynchronously
  viewer.set_object_from_json = (path, json) => { coming += 1; from_json.call(viewer, path, json); };
  viewer.set_object = (path, object) => {
    coming -= 1;
    const glass = object.material && object.material.transparent && !object.material.isShadowMaterial;
    // Draw only the far sides of translucent objects, so that closed objects are not darker.
    if (glass && !object.userData.flat) {
      Object.assign(object.material, { depthWrite: false, side: 1 });
      object.renderOrder = 30; // after what lies on the ground
      stand_behind(object.material);
    }
    // Meshes share corners; smooth shading would blur their edges.
    const mesh = object.geometry && object.geometry.type === "BufferGeometry";
    if (mesh && object.material.isMeshPhongMaterial) object.material.flatShading = true;
    if (glass) object.castShadow = object.receiveShadow = false;
    if (object.userData.trail) {
      let drawn = 0;
      const set = (count) => { drawn = count; object.geometry.setDrawRange(0, 3 * Math.floor(count / 3)); };
      Object.defineProperty(object, "drawn", { get: () => drawn, set });
      object.drawn = 0;
    }
    set_object.call(viewer, path, object);
    viewer.set_dirty();
  };

  // Place of a node in the axes of level ground, also on a ramp, which inclines the node meshcat.
  const level = (name) => viewer.scene.worldToLocal(node(name).getWorldPosition(new THREE.Vector3()));
  const upright = (p) => new THREE.Vector3(p[0], p[2], -p[1]); // from z up to three.js's y up
  const followed = new THREE.Vector3();

  function place_camera() {
    // Both are read: `a || b` would leave the second one unseen.
    const moved = [changed("eye"), changed("target")];
    if (moved.includes(true) && stage.eye && stage.target) {
      viewer.camera.fov = 35;
      const away = upright(stage.eye).distanceTo(upright(stage.target));
      viewer.camera.near = away / 200;
      viewer.camera.far = away * 30;
      viewer.camera.position.copy(upright(stage.eye));
      viewer.controls.target.copy(upright(stage.target));
      followed.copy(upright([0, 0, 0]));
    }
    const now = upright(level("focus").toArray());
    const step = now.clone().sub(followed);
    if (step.lengthSq() > 0) {
      viewer.camera.position.add(step);
      viewer.controls.target.add(step);
      followed.copy(now);
    }
    // A narrow window shows as much from left to right as a wide one.
    const zoom = Math.min(1, viewer.camera.aspect / (stage.aspect || 1.5));
    if (viewer.camera.zoom !== zoom) viewer.camera.zoom = zoom;
  }

  // The light goes along with the robot: its shadow is sharp however large the scene.
  function place_light() {
    const radius = stage.lit || 1;
    const on = node("robot0").position, at = level("robot0"); // z up, as all of the scene
    sun.target.position.copy(at);
    node("ground").position.set(on.x, on.y, 0); // no larger than the shadow: each of its pixels costs time
    sun.position.set(at.x - 1.2 * radius, at.y + 0.7 * radius, at.z + 2.0 * radius);
    if (!changed("lit")) return;
    farther.value = 0.03 * radius; // more than a ghost is larger
    Object.assign(sun.shadow.camera, { left: -radius, right: radius, top: radius, bottom: -radius });
    Object.assign(sun.shadow.camera, { near: 0.1 * radius, far: 6 * radius });
    sun.shadow.camera.updateProjectionMatrix();
    sun.shadow.normalBias = 0.01 * radius;
  }

  function write() {
    if (changed("caption")) element("caption").textContent = stage.caption;
    if (!changed("legend")) return;
    element("legend").replaceChildren(...(stage.legend || []).map(([label, colour, dashes, opacity]) => {
      const row = document.createElement("div");
      row.innerHTML = '<svg width="34" height="6"><line x1="1" y1="3" x2="33" y2="3" stroke-width="5"/></svg>';
      const line = row.querySelector("line");
      if (!colour) row.querySelector("svg").remove();
      else line.setAttribute("stroke", colour);
      if (dashes) { line.setAttribute("stroke-dasharray", dashes); line.setAttribute("stroke-width", 3); }
      if (opacity) line.setAttribute("opacity", opacity);
      row.append(label);
      return row;
    }));
  }

  // Meshcat's picture is as high as the window; this one leaves room for words and player in a narrow one.
  const pane = element("meshcat-pane");
  const set_size = viewer.set_3d_pane_size;
  viewer.set_3d_pane_size = (width = pane.offsetWidth, height = pane.offsetHeight) => {
    set_size.call(viewer, width, height);
  };
  let room = "";
  function fit() {
    const now = `${pane.offsetWidth} ${pane.offsetHeight}`;
    if (now !== room) viewer.set_3d_pane_size();
    room = now;
  }

  const render = viewer.render;
  viewer.render = () => {
    stage = node("stage");
    write();
    fit();
    place_camera();
    place_light();
    render.call(viewer);
  };

  // The player of a recording.
  const animator = viewer.animator;
  const slider = element("slider");
  const show = () => {
    element("toggle").textContent = animator.playing ? "❚❚" : "▶";
    element("toggle").ariaLabel = animator.playing ? "pause" : "play";
  };
  window.pinmobile = {
    ready: () => coming === 0,
    seek(time) {
      animator.pause();
      // Keys have four digits in single precision: without this, a frame shows the key before its own.
      animator.seek(Math.fround(Math.round(1e4 * time) / 1e4));
      animator.display_progress(time);
      slider.ariaValueText = `${time.toFixed(1)} s`;
      viewer.set_dirty();
      viewer.render();
      show();
    },
    play(animations, speed, end) {
      for (const animation of animations) animation.path = animation.path.split("/");
      // Infinity repetitions; 2201 is three.js's LoopRepeat.
      viewer.set_animation(animations, { play: true, loopMode: 2201, repetitions: Infinity });
      animator.mixer.timeScale = speed;
      slider.max = end;
      element("speed").value = String(speed);
      if (element("speed").selectedIndex < 0) {
        element("speed").add(new Option(`${speed} ×`, speed, true, true), 0);
      }
      element("player").hidden = false;
      show();
      const tick = () => {
        requestAnimationFrame(tick);
        if (animator.playing) slider.value = animator.time;
      };
      tick();
    },
  };
  element("toggle").onclick = () => { animator.playing ? animator.pause() : animator.play(); show(); };
  slider.oninput = () => window.pinmobile.seek(Number(slider.value));
  element("speed").onchange = (event) => { animator.mixer.timeScale = Number(event.target.value); };
})();
