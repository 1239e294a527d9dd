% The lecture's simulation: computed torque along the circle, one sample after the other.
%
% octave-cli --no-init-file lecture.m DT DURATION MASS YAW_INERTIA COM_X COM_Y OUTPUT
%
% Prints the seconds of the rollout, references included and the start of Octave not, and the peak
% resident memory in MiB (NaN where the system does not say). OUTPUT holds q, v, a, tau and e: 3 doubles
% each for the first sample, then for the next.
1;

function [q, v, a, tau, e] = rollout(dt, duration, m, Icz, xbc, ybc)
  t = (0:round(duration / dt)) * dt;
  samples = numel(t);
  r = 3; w = 0.1;
  qd = [r * sin(w * t); r - r * cos(w * t); w * t];
  vd = [r * w * cos(w * t); r * w * sin(w * t); w * ones(1, samples)];
  ad = [-r * w^2 * sin(w * t); r * w^2 * cos(w * t); zeros(1, samples)];
  Kp = 4 * eye(3); Kd = 4 * eye(3);
  q = zeros(3, samples); v = q; a = q; tau = q; e = q;
  q(:, 1) = qd(:, 1); v(:, 1) = vd(:, 1);
  for i = 1:samples
    c = cos(q(3, i)); s = sin(q(3, i)); psi_dot = v(3, i);
    M = [m, 0, -m * (ybc * c + xbc * s);
         0, m, m * (xbc * c - ybc * s);
         -m * (ybc * c + xbc * s), m * (xbc * c - ybc * s), m * (xbc^2 + ybc^2) + Icz];
    n = [-m * psi_dot^2 * (xbc * c - ybc * s); -m * psi_dot^2 * (ybc * c + xbc * s); 0];
    e(:, i) = qd(:, i) - q(:, i);
    e(3, i) = mod(e(3, i) + pi, 2 * pi) - pi;
    tau(:, i) = M * (ad(:, i) + Kd * (vd(:, i) - v(:, i)) + Kp * e(:, i)) + n;
    a(:, i) = M \ (tau(:, i) - n);
    if i < samples
      v(:, i + 1) = v(:, i) + dt * a(:, i);
      q(:, i + 1) = q(:, i) + dt * v(:, i) + dt^2 / 2 * a(:, i);
    end
  end
end

function peak = peak_memory()
  peak = NaN;
  if exist("/proc/self/status", "file")
    kib = regexp(fileread("/proc/self/status"), 'VmHWM:\s*(\d+)', "tokens");
    peak = str2double(kib{1}{1}) / 1024;
  end
end

arguments = argv();
numbers = num2cell(str2double(arguments(1:6)));
start = tic();
[q, v, a, tau, e] = rollout(numbers{:});
printf("%.9f %.3f\n", toc(start), peak_memory());
file = fopen(arguments{7}, "w");
fwrite(file, [q; v; a; tau; e], "double");
fclose(file);
